"""Counts of a campaign from its database, in increments: each call reads the rows that were added since the last one.

The queries go to the SQLite driver directly, as those of `progress`: a program that watches asks every few seconds.
Tables with a sequence number are read from the last one on, the others from SQLite's row number, which grows with each
insert, since no row is deleted but that of a discarded rollout.
"""

import sqlite3
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...schemas.result.facts import NO_FAILURE, Header
from .progress import header_in
from .readonly import snapshot

_RUN = "SELECT run FROM campaign"
# +problem: without the sign SQLite reads the whole index of problems in place of the rows after a sequence number.
_ROLLOUTS = "SELECT problem, sum(rollouts), sum(violations), max(seq) FROM rollouts WHERE seq > ? GROUP BY +problem"
_TESTS = "SELECT problem, sum(tests), max(y), max(seq) FROM observations WHERE seq > ? GROUP BY +problem"
# The other columns are those of the row with the highest number: an extension of SQLite.
_BOUNDS = "SELECT problem, upper, max(seq) FROM bounds WHERE seq > ? GROUP BY +problem"
_ATTEMPTS = "SELECT host, count(*), min(rowid), max(rowid) FROM attempts WHERE rowid > ? GROUP BY host ORDER BY 3"
_OUTCOMES = """
    SELECT host, CASE WHEN outcome IN (?, ?, ?) THEN outcome ELSE kind END, count(*), max(outcomes.rowid) FROM outcomes
    JOIN attempts ON attempts.rollout = outcomes.rollout AND attempts.attempt = outcomes.attempt
    WHERE outcomes.rowid > ? GROUP BY 1, 2 ORDER BY min(outcomes.rowid)
"""


@dataclass(frozen=True, slots=True)
class SeriesCounts:
    """The counts of one problem or closing check."""

    tests: int = 0
    """Observed."""
    rollouts: int = 0
    violations: int = 0
    """Rollouts with robustness below 0."""
    greatest: float | None = None
    """The greatest y, which is of the maximised objective J."""
    upper: float | None = None
    """The last upper bound on max J."""


@dataclass(frozen=True, slots=True)
class CampaignCounts:
    """What a campaign has done since its begin, in all its sessions."""

    header: Header
    series: dict[str, SeriesCounts] = field(default_factory=dict)
    """By problem or closing check."""
    attempts: dict[str, int] = field(default_factory=dict)
    """Attempts that were started, by host, in the order in which the hosts came."""
    outcomes: dict[tuple[str, str], int] = field(default_factory=dict)
    """Attempts that ended, by host and a word of `NO_FAILURE` or the kind of failure."""


class CountReader:
    """Reads the counts of a campaign; used by one thread at a time."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._counts: CampaignCounts | None = None
        self._seen: Counter[str] = Counter()
        """Highest number that was read, by query."""

    def read(self) -> CampaignCounts:
        """Return the counts now.

        Raises:
            JournalError: there is no campaign, or it cannot be read.
            OSError: the disk fails.

        """
        with snapshot(self._directory) as connection:
            counts, seen = self._begun(connection)
            series = _added_series(connection, counts.series, seen)
            attempts = Counter(counts.attempts)
            for host, number, _, last in connection.execute(_ATTEMPTS, [seen["attempts"]]):
                attempts[str(host)] += number
                _remember(seen, "attempts", last)
            outcomes = Counter(counts.outcomes)
            for host, kind, number, last in connection.execute(_OUTCOMES, [*NO_FAILURE, seen["outcomes"]]):
                outcomes[str(host), str(kind)] += number
                _remember(seen, "outcomes", last)
        # Only now: a call that fails half-way is repeated whole.
        self._seen = seen
        self._counts = replace(counts, series=series, attempts=dict(attempts), outcomes=dict(outcomes))
        return self._counts

    def _begun(self, connection: sqlite3.Connection) -> tuple[CampaignCounts, Counter[str]]:
        """Return the counts of before; none where another campaign has taken the place of that one."""
        if self._counts is not None:
            (run,) = connection.execute(_RUN).fetchone()
            if run == self._counts.header.run:
                return self._counts, self._seen.copy()
        return CampaignCounts(header_in(connection, self._directory)), Counter()


def _added_series(
    connection: sqlite3.Connection, before: dict[str, SeriesCounts], seen: Counter[str]
) -> dict[str, SeriesCounts]:
    found = dict(before)

    def of(name: str) -> SeriesCounts:
        return found.get(name, SeriesCounts())

    for name, number, violations, last in connection.execute(_ROLLOUTS, [seen["rollouts"]]):
        old = of(name)
        found[name] = replace(old, rollouts=old.rollouts + number, violations=old.violations + int(violations))
        _remember(seen, "rollouts", last)
    for name, number, greatest, last in connection.execute(_TESTS, [seen["tests"]]):
        old = of(name)
        both = greatest if old.greatest is None else max(old.greatest, greatest)
        found[name] = replace(old, tests=old.tests + number, greatest=both)
        _remember(seen, "tests", last)
    for name, upper, last in connection.execute(_BOUNDS, [seen["bounds"]]):
        found[name] = replace(of(name), upper=upper)
        _remember(seen, "bounds", last)
    return found


def _remember(seen: Counter[str], query: str, last: int) -> None:
    seen[query] = max(seen[query], last)
