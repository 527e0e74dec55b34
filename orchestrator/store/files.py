"""Trajectory files: written whole or not at all, and compared with their digest before use."""

import hashlib
import os
import stat
from collections.abc import Iterable, Set
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

from ...schemas.atomic import TEMPORARY, fresh, make_folder, sync, temporary
from ...schemas.errors import EvidenceError
from ...schemas.ids import FileId, RolloutId
from ...schemas.outside import read_outside
from ...schemas.ranges import MAX_FILE_BYTES

FOLDER = "trajectories"
DISCARDED = "discarded"
"""The folder of files whose rollouts were discarded."""
NEWEST = 256
"""Files of which a resume compares the digest, not the size alone."""
SYNCING = 8
"""Files that wait for the disk at a time."""


def relative_path(file: FileId) -> str:
    """Return the place of a file in the run directory, a thousand tests a folder."""
    return f"{FOLDER}/{file.rollout.problem}/{file.rollout.test // 1000}/{file}.mcap"


def discarded_path(rollout: RolloutId, sha256: str) -> str:
    """Return the place where the file of a discarded rollout is kept."""
    return f"{DISCARDED}/{rollout}.{sha256[:16]}.mcap"


def inside(directory: Path, relative: str) -> Path:
    """Return a place in the run directory; the directory itself may be a symbolic link, no folder in it.

    Raises:
        EvidenceError: a folder on the way is a link, through which something else would be changed.

    """
    place = str(directory)  # text, since a Path takes ten times as long, and every rollout asks
    for part in relative.split("/")[:-1]:
        place = f"{place}/{part}"
        if os.path.islink(place):
            raise EvidenceError(
                f"{place}: a symbolic link; put the folder itself there (the run directory as a whole may be a link)"
            )
    return directory / relative


class Batch:
    """Files that become durable together: written inside a `with` block, in place at its end, or not at all.

    Used by one thread. Each file but the last is written and synced in the background while others are admitted.
    """

    def __init__(self) -> None:
        self._written: dict[Path, Path] = {}
        """Places that are still to be filled, and where the files are written beside them."""
        self._last: tuple[Path, bytes] | None = None
        """The one that is not written yet: mostly the only one, for which the way to a thread and back is too long."""
        self._writing: list[Future[None]] = []
        # Side by side: one after the other, a disk on which 740 files a second become durable took 100.
        self._pool = ThreadPoolExecutor(SYNCING, thread_name_prefix="fsync")

    def write(self, path: Path, data: bytes) -> None:
        """Begin to write a file beside its place; an error is raised at the end of the block.

        Raises:
            OSError: the folder cannot be made.

        """
        make_folder(path.parent)
        partial = self._written[path] = temporary(path)
        last, self._last = self._last, (partial, data)
        if last is None:
            return
        try:
            self._writing.append(self._pool.submit(_write_synced, *last))
        except RuntimeError:  # the main thread has ended, and another one goes on: Python starts no thread any more
            _write_synced(*last)

    def __enter__(self) -> None:
        """Begin with nothing."""

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Make everything durable and move it into place; after an error remove it.

        Raises:
            OSError: the disk is full, or a folder cannot be written. What was moved already stays: a file without its
                fact is written again or swept.

        """
        try:
            if kind is None:
                self._settle()
        finally:
            wait(self._writing)  # no thread may still open a file that is removed below
            for partial in self._written.values():
                partial.unlink(missing_ok=True)
            self._written.clear()
            self._writing.clear()
            self._last = None

    def _settle(self) -> None:
        # All files and names are on the disk before the commit of their facts: kill -9 or a power cut between two lines
        # leaves files without facts, whole or not, which a resume sweeps, never facts without files.
        if self._last is None:
            return
        partial, data = self._last
        with fresh(partial) as file:
            file.write(data)
            file.flush()
            for each in self._writing:
                each.result()
            folders = {path.parent for path in self._written}
            for path, place in list(self._written.items()):
                place.replace(path)
                del self._written[path]
            # After the renames: a file system with a journal then has the names on the disk as well, and the folders,
            # which others need, cost no second wait.
            os.fsync(file.fileno())
        for folder in folders:
            sync(folder)


def _write_synced(path: Path, data: bytes) -> None:
    with fresh(path) as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def read_evidence(directory: Path, relative: str, sha256: str) -> bytes:
    """Return the bytes of a recorded file.

    Raises:
        EvidenceError: it is missing, unreadable, or not the file that was recorded.

    """
    data = contents(directory / relative, MAX_FILE_BYTES)
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise EvidenceError(
            f"{directory / relative}: sha256 {found[:12]}... is not the recorded {sha256[:12]}...; "
            "restore it from a copy"
        )
    return data


def contents(path: Path, most: int) -> bytes:
    """Return the bytes of an untrusted file: without waiting for a pipe, and at most `most` of them.

    Raises:
        EvidenceError: it is missing, unreadable, too large, or no file.

    """
    try:
        return read_outside(path, most)
    except OSError as error:
        raise EvidenceError(f"{path}: {error.strerror}; restore it from a copy") from None
    except ValueError:  # a NUL in it, or half a character
        raise EvidenceError(f"{str(path)!r}: no path of a file; give another one") from None


def damaged(
    directory: Path, newest_first: Iterable[tuple[str, int, str]], *, digests: int | None = NEWEST
) -> list[str]:
    """Return those of the recorded files (path, size, sha256) that are missing or changed.

    Sizes are compared for all, digests for the newest, since a power cut damages the files that were written last; with
    None for all.
    """
    found = []
    for number, (path, size, sha256) in enumerate(newest_first):
        try:
            state = os.stat(directory / path)
            good = stat.S_ISREG(state.st_mode) and state.st_size == size
            if good and (digests is None or number < digests):
                read_evidence(directory, path, sha256)
        except (OSError, EvidenceError):
            good = False
        if not good:
            found.append(path)
    return found


def sweep(directory: Path, named: Set[str]) -> None:
    """Remove what a crash left: half-written files, and trajectories, also discarded ones, that no fact has `named`.

    Raises:
        EvidenceError: a folder of trajectories is a symbolic link, through which other files would be removed.

    """
    for folder, folders, names in os.walk(directory):  # which follows no link
        place = Path(folder).relative_to(directory)
        for name in folders:
            if (place / name).parts[0] in (FOLDER, DISCARDED):
                inside(directory, str(place / name / "file"))
        for name in names:
            # Killed between rename and commit: the rollout is simulated again, perhaps under another attempt.
            # Or a discard was killed before its commit.
            ours = place.parts[:1] in ((FOLDER,), (DISCARDED,)) and name.endswith(".mcap")
            orphan = ours and str(place / name) not in named
            if orphan or name.endswith(TEMPORARY):
                os.unlink(Path(folder) / name)
