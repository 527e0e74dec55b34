"""The lock of a run directory for one orchestrator: two flocks, which the kernel releases on kill -9.

The first one is on the folder, which outlives a removed lock file; NFS keeps it on one node. The second one is on a
file in it, open for writing: NFS turns that one into a lock of the server, which all nodes see. The file stays in
place, since a lock on a file that was removed protects nothing.
"""

import errno
import fcntl
import os
import secrets
import shlex
import stat
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ...schemas.errors import PerfboundError
from . import stop_request

LOCK_FILE = "orchestrator.lock"
"""In the run directory, from its first orchestrator on."""
ATTEMPTS = 10
TOKEN = 32
"""Characters of the file: those that its last holder has written."""
_HEXADECIMAL = frozenset(b"0123456789abcdef")
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)


@dataclass(frozen=True)
class RunLock:
    """The lock of a run directory while it is held; `token` names this holder in the file."""

    path: Path
    descriptor: int
    token: bytes

    def is_kept(self) -> bool:
        """Whether no other orchestrator can have had the directory, as far as this node sees."""
        try:
            self.check()
        except PerfboundError:
            return False
        return True

    def check(self) -> None:
        """Refuse to write once another orchestrator may have had the directory.

        An NFS server gives the locks of a node away that it does not reach for long, 90 s as a rule. The node may come
        back, and its orchestrator with it.

        Raises:
            PerfboundError: the lock is lost, or its file was removed or replaced.

        """
        try:
            # Where it is held this changes nothing; NFS asks the server, and reads the file anew.
            kept = _has_locked(self.descriptor) and os.pread(self.descriptor, TOKEN + 1, 0) == self.token
        except OSError:
            kept = False
        if not kept:
            raise PerfboundError(
                f"{self.path}: this orchestrator has lost its lock, and another one may have continued the campaign; "
                "restore the link of this node to the file server, then resume it unless it runs elsewhere"
            )
        if not _is_in_place(self.descriptor, self.path):
            raise PerfboundError(
                f"{self.path}: removed or replaced while the campaign was running, so it keeps no second orchestrator "
                "out; fix what removes files here, then resume it unless it runs elsewhere"
            )


@contextmanager
def campaign_lock(directory: Path) -> Iterator[RunLock]:
    """Lock the campaign in `directory`.

    Raises:
        PerfboundError: another orchestrator has locked it, the file system has no locks, or something else is in the
            place of the lock file.
        OSError: the folder cannot be opened, or the lock file not be written.

    """
    with ExitStack() as stack:
        # CLOEXEC: a child that outlives a killed orchestrator must not keep its lock.
        folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        stack.callback(_release, folder, os.getpid())
        # The folder first, everywhere: else two orchestrators that start at once could refuse each other.
        if not any(_locked_at(folder, directory) for _ in _attempts()):
            raise _running(directory)
        path = directory / LOCK_FILE
        descriptor = next((found for _ in _attempts() if (found := _take_file(path)) is not None), None)
        if descriptor is None:
            raise _running(directory)
        stack.callback(_release, descriptor, os.getpid())
        held = RunLock(path, descriptor, secrets.token_hex(TOKEN // 2).encode())
        # After the server has given the lock away and the next holder has ended, flock succeeds: only this shows it.
        _write_token(held)
        stop_request.withdraw_request(directory)  # of before: it was meant for an orchestrator that has ended
        stack.callback(stop_request.withdraw_request, directory)
        yield held


def _release(descriptor: int, holder: int) -> None:
    """Release a lock that the process `holder` took."""
    # A fork of a notebook has the descriptor too: the lock must not last as long as the fork, nor end with it.
    if os.getpid() == holder:
        with suppress(OSError):  # of a server that has given it away
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)


def forget_lock(held: RunLock) -> None:
    """Remove the lock file of a directory in which no campaign was started; another orchestrator makes a new one."""
    # A lock that is lost may be another one's by now, and a file that was replaced is.
    if held.is_kept():
        with suppress(OSError):
            held.path.unlink()


def is_held(directory: Path) -> bool:
    """Whether an orchestrator has locked the campaign now; nothing is made in the directory.

    Raises:
        PerfboundError: the file system has no locks.
        OSError: the folder cannot be opened.

    """
    folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        if not _locked_at(folder, directory, shared=True):
            return True
    finally:
        os.close(folder)
    path = directory / LOCK_FILE
    try:
        descriptor = _open_plain(path, os.O_RDONLY)
    except OSError:  # none was made yet; or no orchestrator could hold what is there
        return False
    try:
        return _is_regular(descriptor) and not _locked_at(descriptor, path, shared=True)
    finally:
        os.close(descriptor)


def _attempts() -> Iterator[None]:
    # A reader in `is_held` has a shared lock for microseconds: it must not keep an orchestrator from starting.
    for _ in range(ATTEMPTS):
        yield
        time.sleep(0.05)


def _take_file(path: Path) -> int | None:
    """Return the lock file, open and locked; None while it is locked, or was replaced before it was locked."""
    try:
        descriptor = _open_plain(path, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO, errno.ENODEV):
            raise _no_lock_file(path) from None
        raise
    with ExitStack() as refused:
        refused.callback(os.close, descriptor)
        if not _is_regular(descriptor):
            raise _no_lock_file(path)
        if not _locked_at(descriptor, path) or not _is_in_place(descriptor, path):
            return None
        before = os.pread(descriptor, TOKEN + 1, 0)
        # What follows is written over it: a hard link may lead to a file of somebody else.
        if before and (len(before) != TOKEN or not _HEXADECIMAL.issuperset(before)):
            raise _no_lock_file(path)
        refused.pop_all()
    return descriptor


def _write_token(held: RunLock) -> None:
    try:
        os.pwrite(held.descriptor, held.token, 0)
        # On NFS a node that comes back must have nothing left to write over the token of the next holder.
        os.fsync(held.descriptor)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(held.path)) from None


def _open_plain(path: Path, flags: int) -> int:
    # No link is followed, no pipe blocks.
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o666)


def _is_regular(descriptor: int) -> bool:
    return stat.S_ISREG(os.fstat(descriptor).st_mode)


def _is_in_place(descriptor: int, path: Path) -> bool:
    """Whether the path leads to the open file; it is opened, since NFS answers `stat` from a cache."""
    try:
        again = _open_plain(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        return os.path.samestat(os.fstat(again), os.fstat(descriptor))
    finally:
        os.close(again)


def _has_locked(descriptor: int, *, shared: bool = False) -> bool:
    """Lock an open file or folder; return whether nobody else has it."""
    try:
        # Not fcntl's locks, which are lost when any other descriptor of the file is closed in this process.
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _locked_at(descriptor: int, path: Path, *, shared: bool = False) -> bool:
    try:
        return _has_locked(descriptor, shared=shared)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise PerfboundError(
            f"{path}: the file system has no locks ({error.strerror}), which keep a second orchestrator out; mount it "
            "with locks, or choose a directory on another one"
        ) from None


def _no_lock_file(path: Path) -> PerfboundError:
    return PerfboundError(
        f"{path}: not a lock file of perfbound; remove it, after a check that no orchestrator uses the directory"
    )


def _running(directory: Path) -> PerfboundError:
    place = shlex.quote(str(directory))
    return PerfboundError(
        f"{directory}: another orchestrator is running this campaign; "
        f"watch it with `perfbound status {place}`, or stop it with `perfbound stop {place}`"
    )
