"""Durable writing of files: whole in their place and on the disk, or no trace of them.

Each file is written beside its place, synced, and moved; then its folder is synced, since a power cut may take back a
rename as well as bytes.
"""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

TEMPORARY = ".partial"


def temporary(path: Path, tag: str = "") -> Path:
    """Return the place beside `path` where it is written; writers that may meet there need a `tag` each."""
    return path.with_name(f"{path.name}{tag}{TEMPORARY}")


def fresh(path: Path) -> IO[bytes]:
    """Open a new file for writing; what is there is removed first, and a symbolic link in its place is not followed."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        return open(os.open(path, flags, 0o666), "wb")
    except FileExistsError:
        path.unlink()
        return open(os.open(path, flags, 0o666), "wb")


def sync(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents so that they, too, outlive a power cut."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        sync(folder.parent)


def make_private_folder(folder: Path) -> None:
    """Make a folder in which this user alone may do anything, whatever the umask; one that is there stays as it is."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def move(source: Path, path: Path) -> None:
    """Put a file that is on the disk into its place, replacing what is there."""
    source.replace(path)
    sync(path.parent)


def write_whole(path: Path, data: bytes) -> None:
    """Write one file in a folder that has one writer; a half-written one of a crash is overwritten by the next write.

    Raises:
        OSError: the disk is full or the folder cannot be written; no half-written file is left.

    """
    make_folder(path.parent)
    partial = temporary(path)
    try:
        with fresh(partial) as file:
            file.write(data)
        sync(partial)
        move(partial, path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def replacing(paths: Sequence[Path]) -> Iterator[list[IO[bytes]]]:
    """Open files that replace `paths` together at the end of the block; after an error in it nothing changes.

    For places that a user has chosen: several processes may write there at once, and the folders must exist.

    Raises:
        OSError: the disk is full or a folder cannot be written; no half-written file is left.

    """
    partials = [temporary(path, f".{os.getpid()}") for path in paths]
    files: list[IO[bytes]] = []
    try:
        files.extend(fresh(partial) for partial in partials)
        yield files
        for file in files:
            file.flush()
            os.fsync(file.fileno())
        for partial, path in zip(partials, paths, strict=True):
            partial.replace(path)
        for folder in {path.parent for path in paths}:
            sync(folder)
    finally:
        for file in files:
            with suppress(OSError):  # a full disk: the flush of a file that is removed below fails again
                file.close()
        for partial in partials:
            with suppress(OSError):  # a folder that is missing or cannot be written has no partial file
                partial.unlink()


def write_new(contents: Mapping[Path, tuple[bytes, int]]) -> None:
    """Create files (bytes, mode) that do not exist yet, all of them or none.

    Raises:
        FileExistsError: one of them exists; `filename2` names it.
        OSError: the disk is full or a folder cannot be written.

    """
    partials = {path: temporary(path, f".{secrets.token_hex(4)}") for path in contents}
    made: list[Path] = []
    try:
        for path, (data, mode) in contents.items():
            _create(partials[path], data, mode)
        for path, partial in partials.items():
            os.link(partial, path)  # not a rename, which would replace an existing file
            made.append(path)
        for folder in {path.parent for path in contents}:
            sync(folder)
    except OSError:
        for path in made:
            path.unlink()
        raise
    finally:
        for partial in partials.values():
            partial.unlink(missing_ok=True)


def write_folder(folder: Path, contents: Mapping[str, tuple[bytes, int]]) -> None:
    """Create a folder that this user alone can open, with files (bytes, mode); it appears whole, also after a kill.

    Raises:
        FileExistsError: there is something in its place, other than an empty folder.
        OSError: the disk is full or the folder above cannot be written; nothing is left.

    """
    try:
        make_folder(folder.parent)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder.parent)) from None
    partial = temporary(folder, f".{secrets.token_hex(4)}")
    partial.mkdir(mode=0o700)
    try:
        for name, (data, mode) in contents.items():
            _create(partial / name, data, mode)
        sync(partial)
        partial.rename(folder)  # an empty folder is replaced, another one refused
        sync(folder.parent)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        if error.errno in (errno.ENOTEMPTY, errno.ENOTDIR, errno.EEXIST):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(folder)) from None
        raise


def _create(path: Path, data: bytes, mode: int) -> None:
    # The mode is given at creation: a chmod afterwards would leave a moment in which others can open a secret.
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
