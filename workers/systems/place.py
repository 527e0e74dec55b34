"""The place of a worker of its own: a number, a folder and a port that no other live worker of this host has.

A system whose files or ports have fixed names gives other results when two workers of one host run it at a time.
"""

import atexit
import contextlib
import fcntl
import os
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ...schemas.errors import SimulationError

PREFIX = "perfbound-worker-"
"""Of the folders, below the temporary one."""
NUMBERS = range(10_000)
PORTS = range(20_000, 32_000)
"""Below those that the kernel gives to outgoing connections."""
_TAKEN: "dict[int, tuple[Worker, list[object]]]" = {}
"""Process -> its place, with what reserves it: a forked process has a place of its own."""
_TAKING = threading.Lock()


@dataclass(frozen=True, slots=True)
class Worker:
    """What this worker shares with no other live worker of its host: for files, ports and devices of a system."""

    number: int
    """0, 1, ...: the smallest that was free."""
    scratch: Path
    """A folder that is empty at first, and removed at the end of the worker."""
    port: int
    """A port of TCP and UDP that was free."""

    @classmethod
    def own(cls) -> "Worker":
        """Return the place of this process, which keeps it until it ends.

        Raises:
            SimulationError: the temporary folder has no room for it.

        """
        with _TAKING:
            if (found := _TAKEN.get(os.getpid())) is None:
                try:
                    found = _TAKEN[os.getpid()] = _taken()
                except OSError as error:
                    raise SimulationError(
                        f"{tempfile.gettempdir()}: the worker gets no folder of its own there ({error}); set TMPDIR to "
                        "a folder with room, which you may write"
                    ) from None
            return found[0]

    def emptied(self) -> Path:
        """Remove what is in the folder, and return its path."""
        for entry in os.scandir(self.scratch):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path)
            else:
                os.unlink(entry.path)
        return self.scratch


@atexit.register
def leave() -> None:
    """Remove the folder of this process; the kernel frees number and port when it has ended."""
    if (found := _TAKEN.get(os.getpid())) is not None:
        shutil.rmtree(found[0].scratch, ignore_errors=True)


def _taken() -> tuple[Worker, list[object]]:
    number, of_number = _reserved("number", NUMBERS)
    port, of_port = _reserved("port", PORTS)
    _remove_left_behind()
    scratch, of_scratch = _folder(number)
    return Worker(number, scratch, port), [of_number, of_port, of_scratch]


def _reserved(kind: str, candidates: Iterable[int]) -> tuple[int, socket.socket]:
    """Return the first candidate that no live process has, and what reserves it until this one ends, kill -9 too.

    Names of abstract sockets are one for all users and folders of a host, or of a container with a network of its own.
    """
    for each in candidates:
        reserving = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            reserving.bind(f"\0perfbound-{kind}-{each}")
        except OSError:
            reserving.close()
            continue
        if kind != "port" or _is_free(each):
            return each, reserving
        reserving.close()
    raise OSError(f"no {kind} is free")


def _is_free(port: int) -> bool:
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        with socket.socket(socket.AF_INET, kind) as tried:
            try:
                tried.bind(("", port))
            except OSError:
                return False
    return True


def _folder(number: int) -> tuple[Path, int]:
    """Return a new folder and the lock on it, which tells others that it is in use."""
    while True:
        path = tempfile.mkdtemp(prefix=f"{PREFIX}{number}-")
        # Another worker may take it for one that was left behind before it is locked.
        with contextlib.suppress(FileNotFoundError):
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
            fcntl.flock(lock, fcntl.LOCK_EX)
            if os.path.exists(path):
                return Path(path), lock
            os.close(lock)


def _remove_left_behind() -> None:
    """Remove the folders of workers that were killed: those of this user that nobody has locked."""
    for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(lock).st_uid == os.getuid():
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)
