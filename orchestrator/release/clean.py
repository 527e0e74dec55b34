"""Clean-up of a folder of runs: which run directories can go, and their removal.

A run that is locked or signed always stays, as does one with files that perfbound has not written.
"""

import fnmatch
import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...schemas.amounts import amount, counted
from ...schemas.errors import PerfboundError, one_line
from ..certificate import files
from ..certificate.verify.run import verify_certificate
from ..certificate.verify.stages import Report
from ..certificate.words.format import duration
from ..report.listing import last_change, run_directories
from ..report.write import COUNTEREXAMPLES, FIGURES
from ..store import so_far, stop_request
from ..store.export import DEFAULT
from ..store.files import DISCARDED, FOLDER
from ..store.lock import LOCK_FILE, campaign_lock, is_held
from ..store.rows import DATABASE

OWN = (
    f"{DATABASE}*",
    LOCK_FILE,
    so_far.NAME,
    stop_request.NAME,
    *(name.replace(".", "*.", 1) for name in files.OF_CERTIFICATE),
    COUNTEREXAMPLES,
    FOLDER,
    DISCARDED,
    FIGURES,
    DEFAULT,
)
"""Patterns of what perfbound writes into a run directory."""


@dataclass(frozen=True, slots=True)
class Judged:
    """One run directory, and whether it can go."""

    directory: Path
    kept: str
    """Why it stays; empty where it can go."""
    size: int
    """Bytes of its files."""
    age: float
    """Seconds since its last change."""


def judge_runs(folder: Path, *, older: float, keep_verified: bool, report: Report) -> list[Judged]:
    """Judge the run directories in a folder: those that nobody has changed for `older` seconds can go.

    With `keep_verified` those whose certificate verifies stay as well, which takes a verification of each.

    Raises:
        Stopped: a signal arrived.

    """
    directories = sorted(run_directories(folder))
    found = list[Judged]()
    for number, directory in enumerate(directories, 1):
        age = time.time() - max(last_change(directory), _of_log(directory))
        kept = _kept(directory, age, older, keep_verified=keep_verified, report=report)
        found.append(Judged(directory, kept, _size(directory), age))
        report("runs", number, len(directories))
    return found


def _of_log(directory: Path) -> float:
    # While an orchestrator runs, and after kill -9, the last commits are in this file alone.
    log = directory / f"{DATABASE}-wal"
    return log.stat().st_mtime if log.exists() else 0.0


def _kept(directory: Path, age: float, older: float, *, keep_verified: bool, report: Report) -> str:
    """Return why a run directory stays; empty where it can go."""
    if is_held(directory):
        return "running"
    names = os.listdir(directory)
    if _is_signed(names):
        return "signed"
    if age < older:
        return "newer"
    if strange := sorted(name for name in names if not any(fnmatch.fnmatch(name, own) for own in OWN)):
        more = f" and {len(strange) - 1} more" if len(strange) > 1 else ""
        return f"with {one_line(strange[0])}{more}, not written by perfbound"
    if keep_verified and files.CERTIFICATE in names:
        try:
            verified = verify_certificate(directory, key=None, again=0, report=report)
        except (PerfboundError, OSError) as error:
            return f"not to be verified: {one_line(str(error))}"
        if verified.checks.good:
            return "verified"
    return ""


def _is_signed(names: Iterable[str]) -> bool:
    return any(fnmatch.fnmatch(name, "certificate*.dsse.json") for name in names)


def _size(directory: Path) -> int:
    """Return the bytes of the files in a directory, none of those behind links."""
    return sum(os.lstat(Path(root, name)).st_size for root, _, names in os.walk(directory) for name in names)


def summary(found: Sequence[Judged]) -> list[str]:
    """Return a line on each run that can go, then on those that stay, and what the removal frees."""
    going = [each for each in found if not each.kept]
    staying = sorted(Counter(each.kept for each in found if each.kept).items())
    freed = amount(sum(each.size for each in going))
    return [
        *(f"{each.directory}  {amount(each.size)}, unchanged for {duration(each.age)}" for each in going),
        *(f"stays: {counted(number, 'run')}, {why}" for why, number in staying),
        f"{counted(len(going), 'run')} of {len(found):,} can go, which frees {freed}",
    ]


def remove_runs(found: Sequence[Judged], done: Callable[[Judged, str], None]) -> int:
    """Remove the run directories that can go; return the bytes that were freed.

    `done` gets each, with the reason why it stays after all, as where it has just been resumed.
    """
    freed = 0
    for each in found:
        if each.kept:
            continue
        try:
            # Under the lock: an orchestrator that starts now finds it taken.
            with campaign_lock(each.directory):
                if _is_signed(os.listdir(each.directory)):
                    raise PerfboundError("it has just been signed")
                _remove(each.directory)
        except (PerfboundError, OSError) as error:
            done(each, one_line(str(error)))
            continue
        freed += each.size
        done(each, "")
    return freed


def _remove(directory: Path) -> None:
    """Remove a run directory: first its certificate, which would have no evidence, and last its database.

    After a crash in between it is listed as before, and the next clean-up continues.
    """
    (directory / files.CERTIFICATE).unlink(missing_ok=True)
    for path in directory.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif not path.name.startswith(DATABASE):
            path.unlink()
    shutil.rmtree(directory)
