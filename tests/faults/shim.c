/* Loaded before the C library: a slow disk, a disk with errors, and a wall clock that jumps.

   SHIM_FSYNC_MS   milliseconds that every fsync and fdatasync lasts longer
   SHIM_EIO        folder of planned errors: a file `read`, `write`, `fsync` or `rename` in it makes the next such call on
                   something below SHIM_BELOW fail with EIO, once; the call moves the file to `taken/` in that folder.
                   A write that fails has written half of its bytes.
   SHIM_BELOW      the folder whose files fail
   SHIM_CLOCK      file with the seconds by which CLOCK_REALTIME is wrong, read at every look; CLOCK_MONOTONIC is not touched */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static int below(const char *path) {
    const char *folder = getenv("SHIM_BELOW");
    return folder && strncmp(path, folder, strlen(folder)) == 0;
}

/* Whether an error is planned for this call; who asks first takes it, because a rename succeeds once. */
static int taken(const char *call, const char *path) {
    const char *plan = getenv("SHIM_EIO");
    char planned[PATH_MAX], done[PATH_MAX + 64];
    snprintf(planned, sizeof planned, "%s/%s", plan, call);
    if (!below(path) || syscall(SYS_faccessat, AT_FDCWD, planned, F_OK)) return 0;
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now);
    snprintf(done, sizeof done, "%s/taken/%s-%ld-%ld", plan, call, (long)now.tv_sec, now.tv_nsec);
    return syscall(SYS_renameat, AT_FDCWD, planned, AT_FDCWD, done) == 0;
}

static int fails(const char *call, int fd) {
    char link[64], path[PATH_MAX];
    int before = errno;
    if (!getenv("SHIM_EIO")) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    long size = syscall(SYS_readlinkat, AT_FDCWD, link, path, sizeof path - 1);
    if (size > 0) path[size] = 0;
    int found = size > 0 && taken(call, path);
    errno = found ? EIO : before;
    return found;
}

ssize_t read(int fd, void *to, size_t size) { return fails("read", fd) ? -1 : syscall(SYS_read, fd, to, size); }

ssize_t pread64(int fd, void *to, size_t size, off64_t at) {
    return fails("read", fd) ? -1 : syscall(SYS_pread64, fd, to, size, at);
}

ssize_t pread(int fd, void *to, size_t size, off_t at) { return pread64(fd, to, size, at); }

ssize_t write(int fd, const void *from, size_t size) {
    int bad = fails("write", fd);
    ssize_t done = syscall(SYS_write, fd, from, bad ? size / 2 : size);
    return bad ? errno = EIO, -1 : done;
}

ssize_t pwrite64(int fd, const void *from, size_t size, off64_t at) {
    int bad = fails("write", fd);
    ssize_t done = syscall(SYS_pwrite64, fd, from, bad ? size / 2 : size, at);
    return bad ? errno = EIO, -1 : done;
}

ssize_t pwrite(int fd, const void *from, size_t size, off_t at) { return pwrite64(fd, from, size, at); }

ssize_t writev(int fd, const struct iovec *parts, int count) {
    return fails("write", fd) ? -1 : syscall(SYS_writev, fd, parts, count);
}

int rename(const char *from, const char *to) {
    if (getenv("SHIM_EIO") && taken("rename", to)) return errno = EIO, -1;
    return (int)syscall(SYS_renameat, AT_FDCWD, from, AT_FDCWD, to);
}

static void wait_for_disk(void) {
    const char *text = getenv("SHIM_FSYNC_MS");
    long ms = text ? atol(text) : 0;
    struct timespec span = {ms / 1000, (ms % 1000) * 1000000L};
    nanosleep(&span, NULL);
}

int fsync(int fd) {
    wait_for_disk();
    return fails("fsync", fd) ? -1 : (int)syscall(SYS_fsync, fd);
}

int fdatasync(int fd) {
    wait_for_disk();
    return fails("fsync", fd) ? -1 : (int)syscall(SYS_fdatasync, fd);
}

static long offset(void) {
    const char *path = getenv("SHIM_CLOCK");
    char text[32] = {0};
    if (!path) return 0;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return 0;
    ssize_t got = read(fd, text, sizeof text - 1);
    close(fd);
    return got > 0 ? atol(text) : 0;
}

int clock_gettime(clockid_t clock, struct timespec *at) {
    int code = (int)syscall(SYS_clock_gettime, clock, at);
    if (code == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) at->tv_sec += offset();
    return code;
}

int gettimeofday(struct timeval *at, void *zone) {
    int code = (int)syscall(SYS_gettimeofday, at, zone);
    if (code == 0 && at) at->tv_sec += offset();
    return code;
}

time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}
