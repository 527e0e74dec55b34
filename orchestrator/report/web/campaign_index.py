"""The campaigns below a folder, kept in memory and read again where their files changed: for the index page."""

import json
import math
import os
import stat
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Literal
from urllib.parse import quote

from ....schemas.errors import PerfboundError, shortened
from ....schemas.result.facts import Header
from ....schemas.result.known import CampaignVerdict, VerdictWord
from ....schemas.values import ProblemProgress
from ...certificate.files import CERTIFICATE
from ...certificate.words.bound_text import in_unit, outward
from ...certificate.words.known_text import required_bound
from ...forecast.remaining import budget
from ...run.display.progress_table import bound_in_sense
from ...store import lock
from ...store.export_tables import robustness_unit
from ...store.progress import read_progress
from ...store.rows import DATABASE
from ..listing import ListedCampaign, ListedState, read_campaign, run_directories, unreadable

MOST_CAMPAIGNS = 5000
"""Run directories that an index has; of more it has the first that it finds, and says so."""
MOST_OF_A_READ = 0.05
"""Share of the time that a campaign which changes all the time is read: a large one takes seconds."""
LONGEST_LINK = 700
"""Bytes; a longer address would leave no room for what follows it."""
AT_EVERY_TEST = ("rigorous", "scenario")
"""Methods whose bounds hold after every test, with one probability for all of them."""
PREFIX = "runs/"
"""Of the addresses of campaigns."""

# Of files, and kept in memory alone: a cache beside the runs could disagree, and network disks report no changes.
_Stamp = tuple[tuple[int, int, int] | None, ...]


@dataclass(frozen=True, slots=True)
class IndexRow:
    """What an index shows of one campaign."""

    path: str
    """Below the folder of the index; "." for the folder itself."""
    href: str
    """Address of its page relative to that of the index; empty where it has none."""
    name: str
    state: ListedState | Literal["unread"]
    verdict: VerdictWord | None = None
    bound: str = ""
    """Of the first claim with its sense and unit, rounded to the safe side."""
    value: float | None = None
    """The bound as a number, to sort by."""
    so_far: str = ""
    """The bound that holds now, of an unfinished campaign about one problem."""
    required: str = ""
    claim: str = ""
    """The first claim in words."""
    refuted: bool = False
    """Whether something that it rests on is refuted."""
    reason: str = ""
    """The first reason of a verdict other than SHOWN."""
    rollouts: int = 0
    violations: int = 0
    tests: int | None = None
    """Of all problems; None for a finished campaign."""
    most_tests: int | None = None
    """At the end of their budgets."""
    changed: float = 0.0
    """Unix time of the last change of the database."""
    fault: str = ""
    """Why it cannot be read."""


@dataclass(frozen=True, slots=True)
class IndexChanges:
    """What changed in an index since some moment."""

    number: int
    """Of this moment."""
    whole: bool
    """Whether the rows are all that there are, because some were removed or this is the first moment."""
    rows: tuple[IndexRow, ...]
    unread: int
    """Campaigns that have not been read yet."""
    more: bool
    """Whether there are more than `MOST_CAMPAIGNS`."""

    def to_json(self, **further: float | str) -> str:
        """Return it as JSON that is safe inside a <script> element of a page."""
        text = json.dumps({**asdict(self), **further}, allow_nan=False, separators=(",", ":"))
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@dataclass(slots=True)
class _Entry:
    """A campaign of the index."""

    directory: Path
    stamp: _Stamp
    """Of its files when it was read last."""
    due: float
    """Monotonic time before which it is not read again."""
    number: int
    """Of the moment at which its row changed last."""
    row: IndexRow


@dataclass(slots=True)
class CampaignIndex:
    """The campaigns below `folder`; refreshed by one thread at a time, and asked from any.

    `report` takes every unexpected error as one line.
    """

    folder: Path
    report: Callable[[str], None]
    _entries: dict[str, _Entry] = field(default_factory=dict)
    _number: int = 0
    _removed: int = 0
    """Number of the moment at which a campaign was removed last."""
    _more: bool = False
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def refresh(self, seconds: float) -> None:
        """Look for new and removed campaigns, then read those that changed for about so many seconds.

        Raises:
            OSError: the folder cannot be read.

        """
        began = time.monotonic()
        self._find()
        for path, entry in self._in_order():
            if (stamp := _stamp(entry.directory)) != entry.stamp and time.monotonic() >= entry.due:
                self._read(path, entry, stamp)
                if time.monotonic() - began > seconds:
                    return

    def since(self, number: int) -> IndexChanges:
        """Return what changed since the moment with this number; all rows for -1 and for an unknown moment."""
        with self._lock:
            whole = not self._removed <= number <= self._number
            rows = (entry.row for entry in self._entries.values() if whole or entry.number > number)
            return IndexChanges(self._number, whole, tuple(rows), self._count_unread(), self._more)

    @property
    def number(self) -> int:
        """Number of this moment."""
        with self._lock:
            return self._number

    @property
    def unread(self) -> int:
        """Campaigns that were found and have not been read yet."""
        with self._lock:
            return self._count_unread()

    def _count_unread(self) -> int:
        return sum(entry.row.state == "unread" for entry in self._entries.values())

    def directory(self, path: bytes) -> Path | None:
        """Return the run directory with this path below the folder; None if there is none, or a link leads to it."""
        with self._lock:
            found = self._entries.get(os.fsdecode(path))
        return (
            found.directory if found and found.row.href and _has_plain_database(self.folder, found.directory) else None
        )

    def _find(self) -> None:
        """Add the new run directories as unread ones, and remove those that are gone."""
        found = list(islice(_with_paths(self.folder), MOST_CAMPAIGNS + 1))
        self._more = len(found) > MOST_CAMPAIGNS
        kept = dict(found[:MOST_CAMPAIGNS])
        with self._lock:
            for path in [path for path in self._entries if path not in kept]:
                del self._entries[path]
                self._removed = self._number = self._number + 1
            for path, directory in kept.items():
                if path not in self._entries:
                    self._number += 1
                    self._entries[path] = _Entry(directory, (), 0.0, self._number, _unread(path, directory))

    def _in_order(self) -> list[tuple[str, _Entry]]:
        """Return the unread campaigns, the one that changed last first, then the others."""
        return sorted(self._entries.items(), key=lambda pair: (pair[1].row.state != "unread", -pair[1].row.changed))

    def _read(self, path: str, entry: _Entry, stamp: _Stamp) -> None:
        began = time.monotonic()
        row = self._row(path, entry.directory)
        ended = time.monotonic()
        with self._lock:
            entry.stamp, entry.due = stamp, ended + (ended - began) / MOST_OF_A_READ
            if row != entry.row:
                self._number += 1
                entry.row, entry.number = row, self._number

    def _row(self, path: str, directory: Path) -> IndexRow:
        unread = _unread(path, directory)
        if not _has_plain_database(self.folder, directory):
            return replace(unread, href="", state="damaged", fault=f"{DATABASE} is a link or no file")
        try:
            listed, verdict = read_campaign(directory, unread.changed)
            return _finished_row(unread, listed, verdict) if verdict else _unfinished_row(unread, listed)
        except Exception as error:  # noqa: BLE001  (any: one campaign must not disturb the others)
            self.report(f"{directory}: not in the index: {error!r}")
            return replace(unread, state="damaged", fault=shortened(f"internal error: {error!r}"))


def _with_paths(folder: Path) -> Iterable[tuple[str, Path]]:
    for directory in run_directories(folder):
        yield str(directory.relative_to(folder)), directory


def _unread(path: str, directory: Path) -> IndexRow:
    href = "" if path == "." else f"{PREFIX}{quote(os.fsencode(path))}/"
    return IndexRow(
        path=shortened(path),
        href=href if len(href) <= LONGEST_LINK else "",
        name=shortened(directory.name),
        state="unread",
        changed=_last_change(directory),
    )


def _last_change(directory: Path) -> float:
    """Return the Unix time of the last change; what a run commits is in the log first."""
    found = (_file_stamp(directory / name) for name in (DATABASE, f"{DATABASE}-wal"))
    return max((each[0] / 1e9 for each in found if each is not None), default=0.0)


def _listed_row(row: IndexRow, listed: ListedCampaign) -> IndexRow:
    return replace(
        row,
        name=shortened(listed.name),
        state=listed.state,
        verdict=listed.verdict,
        bound=shortened(listed.bound),
        rollouts=listed.rollouts,
        violations=listed.violations or 0,
        # The place is in the row; a page has no use for the path on this machine.
        fault=shortened(listed.fault.replace(f"{listed.directory}/", "").replace(f"{listed.directory}: ", "")),
    )


def _finished_row(row: IndexRow, listed: ListedCampaign, found: CampaignVerdict) -> IndexRow:
    return replace(
        _listed_row(row, listed),
        value=found.bound,
        required=shortened(required_bound(found)),
        claim=shortened(found.claim),
        refuted=listed.refuted,
        reason=shortened(found.reasons[0]) if found.verdict != "SHOWN" and found.reasons else "",
    )


def _unfinished_row(row: IndexRow, listed: ListedCampaign) -> IndexRow:
    row = _listed_row(row, listed)
    if listed.fault:
        return row
    try:
        progress = read_progress(listed.directory)
    except (PerfboundError, OSError) as error:
        return replace(row, state=unreadable(error), fault=shortened(str(error)))
    config = progress.header.config
    pairs = list(zip(config.problems, progress.problems, strict=True))
    return replace(
        row,
        tests=sum(each.tests for _, each in pairs),
        most_tests=sum(budget(config, problem, each.extended) for problem, each in pairs),
        so_far=shortened(_bound_so_far(progress.header, progress.problems)),
    )


def _bound_so_far(header: Header, progress: Sequence[ProblemProgress]) -> str:
    """Return the bound that holds now; empty where no claim is that of one problem, or none holds before the end."""
    (problem, *others), config = header.config.problems, header.config
    # The risk that a linearised bound proves is another function of it.
    if others or problem.method not in AT_EVERY_TEST or getattr(problem, "linearised", None) is not None:
        return ""
    bound = bound_in_sense(config, problem, progress[0])
    if bound is None or not math.isfinite(bound):
        return ""
    if config.sense_of(problem) == "max":
        return f"<= {outward(bound, '<=')}"
    return f">= {in_unit(outward(bound, '>='), robustness_unit(config, header.spec))}"


def _stamp(directory: Path) -> _Stamp:
    """Return what differs after every change of a campaign: of its files, and of the lock."""
    names = (DATABASE, f"{DATABASE}-wal", CERTIFICATE)
    return (*(_file_stamp(directory / name) for name in names), _lock_stamp(directory))


def _file_stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def _lock_stamp(directory: Path) -> tuple[int, int, int] | None:
    try:
        return (1, 0, 0) if lock.is_held(directory) else None
    except OSError:
        return None


def _has_plain_database(folder: Path, directory: Path) -> bool:
    """Whether the database in a directory below a folder is a regular file, reached without a link."""
    path = folder.resolve() / directory.relative_to(folder) / DATABASE
    try:
        return stat.S_ISREG(path.lstat().st_mode) and path.resolve() == path
    except OSError:
        return False
