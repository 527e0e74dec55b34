"""Trajectory files: written whole or not at all, and checked against their digest before anything reads them."""

import hashlib
import os
from pathlib import Path

from orchestrator.campaign import RolloutId
from orchestrator.errors import EvidenceError

FOLDER = "trajectories"
TEMPORARY = ".partial"


def relative_path(rollout: RolloutId) -> str:
    """Return where a rollout's file stands in the run directory, a thousand tests a folder."""
    return f"{FOLDER}/{rollout.problem}/{rollout.test // 1000}/{rollout}.mcap"


def write(path: Path, data: bytes) -> None:
    """Write a file durably: temporary file, fsync, rename, fsync of the folder.

    Raises:
        OSError: the disk is full or the folder cannot be written; no half-written file is left.

    """
    _make_folder(path.parent)
    temporary = path.with_name(path.name + TEMPORARY)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _make_folder(folder: Path) -> None:
    """Make a folder and its parents so that they, too, outlive a power cut."""
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        _sync_folder(folder.parent)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read(directory: Path, relative: str, sha256: str) -> bytes:
    """Return the bytes of a recorded file.

    Raises:
        EvidenceError: it is missing, unreadable, or not the file that was recorded.

    """
    try:
        data = (directory / relative).read_bytes()
    except OSError as error:
        raise EvidenceError(f"{directory / relative}: {error.strerror}; restore it from a copy") from None
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise EvidenceError(
            f"{directory / relative}: sha256 {found[:12]}... is not the recorded {sha256[:12]}...; "
            "restore it from a copy"
        )
    return data


def sweep(directory: Path) -> None:
    """Remove what a crash left half-written."""
    for leftover in directory.rglob(f"*{TEMPORARY}"):
        leftover.unlink(missing_ok=True)
