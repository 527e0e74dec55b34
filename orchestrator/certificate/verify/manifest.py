"""Parser of `manifest.sha256`, and the check of the trajectory files against its digests."""

import hashlib
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from ....schemas.errors import EvidenceError
from ....schemas.ids import FileId, RolloutId
from ...store import files
from .checks import CheckFailed

_ROLLOUT = r"[a-z_]{1,40}\.\d{1,9}\.[a-z]{1,10}\.\d{1,6}"
_LINE = re.compile(rf"([0-9a-f]{{64}})  (trajectories/[a-z_]+/\d{{1,6}}/({_ROLLOUT}(?:\.\d{{1,4}})?)\.mcap)")
_KEPT = re.compile(rf"([0-9a-f]{{64}})  ({files.DISCARDED}/({_ROLLOUT})\.[0-9a-f]{{16}}\.mcap)")
SHOWN = 3
"""Damaged files that a failed check names."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One file of the manifest."""

    sha256: str
    path: str


def split_manifest(text: str) -> tuple[str, list[tuple[RolloutId, Entry]]]:
    """Return the part of a manifest with the observed rollouts, and the discarded ones, which are its last lines.

    Raises:
        CheckFailed: a discarded rollout has another path than its digest gives.

    """
    lines, kept = text.splitlines(keepends=True), list[tuple[RolloutId, Entry]]()
    while lines and (match := _KEPT.fullmatch(lines[-1].removesuffix("\n"))) is not None:
        rollout = RolloutId.parse(match[3])
        if files.discarded_path(rollout, match[1]) != match[2]:
            raise CheckFailed("manifest", f"line {len(lines)}: {match[2]} is not the path of that file")
        kept.insert(0, (rollout, Entry(match[1], match[2])))
        lines.pop()
    return "".join(lines), kept


def parse_manifest(text: str) -> Mapping[FileId, Entry]:
    """Return the files of the observed rollouts and batches of a manifest, in its order.

    Raises:
        CheckFailed: a line has another form, or a rollout is listed twice.

    """
    found: dict[FileId, Entry] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        # One form only: a path with `..` or a second spelling of a rollout could point at other files.
        match = _LINE.fullmatch(line)
        if match is None or not line.isascii():
            raise CheckFailed("manifest", f"line {number} is not a digest and the path of a trajectory")
        file = FileId.parse(match[3])
        if files.relative_path(file) != match[2]:
            raise CheckFailed("manifest", f"line {number}: {match[2]} is not the path of {file}")
        if file in found:
            raise CheckFailed("manifest", f"line {number}: {file} is listed twice")
        found[file] = Entry(match[1], match[2])
    return found


def check_files(directory: Path, entries: Collection[Entry], progress: Callable[[int], None]) -> None:
    """Compare the digest of every file; `progress` is called with the number of files read.

    Raises:
        CheckFailed: some are missing or changed.

    """
    faults: list[str] = []
    # All files, not up to the first fault: their number distinguishes a damaged disk from an edit.
    for number, entry in enumerate(entries, start=1):
        try:
            files.read_evidence(directory, entry.path, entry.sha256)
        except EvidenceError as error:
            faults.append(f"{entry.path}: {str(error).partition(': ')[2].partition(';')[0]}")
        progress(number)
    if faults:
        more = f"; and {len(faults) - SHOWN} more" if len(faults) > SHOWN else ""
        raise CheckFailed("files", f"{len(faults):,} of {len(entries):,}: {'; '.join(faults[:SHOWN])}{more}")


def sha256_of(data: bytes) -> str:
    """Return the digest of bytes, as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
