"""The one reader of files from outside: never waiting for a pipe or a device, and bounded."""

import errno
import os
import stat
from pathlib import Path


def read_outside(path: Path, most: int) -> bytes:
    """Return the bytes of a file that anybody may have written, at most `most` of them.

    Raises:
        OSError: it is missing, unreadable, too large, or no regular file; `strerror` says which.

    """
    return read_with_status(path, most)[0]


def read_with_status(path: Path, most: int) -> tuple[bytes, os.stat_result]:
    """Return the bytes of a file as `read_outside`, and its status."""
    # Opened first, examined then: between a stat and an open the file could be exchanged. A pipe without O_NONBLOCK
    # would block for good.
    with open(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "not a file", str(path))
        # By its size, not by the limit: as many bytes as are asked for are allocated.
        data = file.read(min(most, status.st_size) + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than {most} bytes", str(path))
    return data, status


def exposed(status: os.stat_result) -> bool:
    """Whether a file of secrets can be read by others, as ssh sees it."""
    # A file of another owner is readable here through its group, which is on purpose; to all it never is.
    forbidden = 0o077 if status.st_uid == os.geteuid() else 0o007
    return bool(status.st_mode & forbidden)
