"""The robustness of the rollouts behind the bounds and in the closing checks of a campaign, in test order.

The queries go to the SQLite driver directly, as those of `progress`: `perfbound list` reads many campaigns.
"""

import json
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ...schemas.ids import RECHECK, SHRINK, RolloutId, closing_check, series_order
from ...schemas.result.known import Violations
from .readonly import snapshot

_SERIES = "SELECT DISTINCT problem FROM tests"
# A test without an observation is under way, and which of its rollouts came first may depend on their outcome.
_OF = """
    FROM each_rollout JOIN each_test USING (problem, test) JOIN each_observation USING (problem, test)
    WHERE variant = ? AND problem IN (SELECT value FROM json_each(?)) AND robustness IS NOT NULL
"""
_COUNTS = f"""
    SELECT count(*), count(CASE WHEN robustness < 0 THEN 1 END), count(DISTINCT x),
    count(DISTINCT CASE WHEN robustness < 0 THEN x END), min(robustness) {_OF}
"""
_WORST = f"SELECT problem, test, replicate {_OF} AND robustness = ? ORDER BY problem, test, replicate LIMIT 1"
_ORDER = "ORDER BY robustness, problem, test, replicate LIMIT 1"
_ROLLOUTS = _OF.replace("JOIN each_test USING (problem, test) ", "")
_NUMBER = f"SELECT count(*) {_ROLLOUTS}"
_RANKED = f"SELECT problem, test, replicate, robustness {_ROLLOUTS}"
_NTH = f"{_RANKED} {_ORDER} OFFSET ?"
_BEST = f"{_RANKED} ORDER BY robustness DESC, problem, test, replicate LIMIT 1"
_FIRST = f"{_RANKED} AND robustness < 0 ORDER BY test, replicate LIMIT 1"
# Beside the only min(), SQLite takes the columns that are no aggregates from a row that has it.
_STARTS = """
    SELECT problem, test, count(CASE WHEN robustness < 0 THEN 1 END) AS violations, count(*), min(robustness)
    FROM each_rollout JOIN each_test USING (problem, test)
    WHERE problem IN (SELECT value FROM json_each(?)) AND robustness IS NOT NULL
    GROUP BY x HAVING violations > 0
"""
_RECORDED = "SELECT total(rollouts) FROM rollouts"
_ANY_BLOCK = "SELECT 1 FROM rollouts WHERE seeds IS NOT NULL LIMIT 1"
_ROW = "r.problem, r.test, r.replicate, r.replicates, r.places, r.rollouts, r.violations"
_WHICH = "r.variant = ? AND r.problem IN (SELECT value FROM json_each(?)) AND r.robustness IS NOT NULL"
_BATCHES = """
    SELECT :row, r.robustness, r.robustness_of, t.x, t.starts, t.tests, r.test - t.test FROM rollouts r
    JOIN tests t ON t.problem = r.problem AND t.test = r.block
    JOIN observations o ON o.problem = r.problem AND o.test = r.block WHERE :which
""".replace(":row", _ROW).replace(":which", _WHICH)
_VALUES = f"SELECT test, replicate, x, robustness {_OF} ORDER BY test, replicate"

# A recheck observes 1 where both trajectories agree; their files differ, because each names its rollout.
_SAME = """
    SELECT again.problem FROM each_rollout AS one JOIN each_rollout AS again USING (variant, seed)
    JOIN observations ON observations.problem = again.problem AND observations.test = again.test
    WHERE one.problem = ? AND one.test = ? AND variant = ? AND one.replicate = ? AND y = 1
"""


class RolloutValue(NamedTuple):
    """The robustness of one rollout, clipped."""

    series: str
    test: int
    replicate: int
    start: str
    """As the database has it: equal for equal starts."""
    robustness: float


class RankedRollout(NamedTuple):
    """One rollout of those behind the bounds and in the closing checks."""

    rollout: RolloutId
    robustness: float


class RankedRollouts(NamedTuple):
    """The rollouts of a variant at the ends and in the middle of their order by robustness; `first` violates."""

    number: int
    worst: RankedRollout
    median: RankedRollout
    best: RankedRollout
    first: RankedRollout | None


class StartViolations(NamedTuple):
    """The violations at one start, that of a test whose rollout has the least robustness."""

    series: str
    test: int
    violations: int
    rollouts: int
    least: float


def read_violations(directory: Path, variant: str) -> Violations:
    """Return how many rollouts of a variant violate the specification.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        series = _new_series(connection)
        if connection.execute(_ANY_BLOCK).fetchone() is not None:
            return _violations_with_blocks(connection, variant, series)
        which = [variant, json.dumps(series)]
        rollouts, violations, starts, violating, least = connection.execute(_COUNTS, which).fetchone()
        worst = connection.execute(_WORST, [*which, least]).fetchone()
    return Violations(
        rollouts=rollouts,
        violations=violations,
        starts=starts,
        violating_starts=violating,
        least=least,
        rollout=worst and str(RolloutId(worst[0], worst[1], variant, worst[2])),
    )


def _violations_with_blocks(connection: sqlite3.Connection, variant: str, series: list[str]) -> Violations:
    """Return the same without a row for each rollout, of which a million takes a second to make."""
    rollouts = violations = 0
    starts, violating = set[bytes](), set[bytes]()
    least: tuple[float, str, int, int] | None = None
    for row in _batches(connection, variant, series):
        rollouts, violations = rollouts + row.rollouts, violations + row.violations
        width = len(row.starts) // row.tests
        each = [
            row.starts[width * k : width * (k + 1)] for k in range(row.first, row.first + row.places // row.replicates)
        ]
        starts.update(each)
        if not row.violations and least is not None and row.robustness > least[0]:
            continue
        values = struct.unpack(f"<{row.places}d", row.values)
        for place, value in enumerate(values):
            test, number = divmod(place, row.replicates)
            if value < 0:
                violating.add(each[test])
            found = (value, row.problem, row.test + test, row.replicate + number)
            least = min(least, found) if least is not None else found
    return Violations(
        rollouts=rollouts,
        violations=violations,
        starts=len(starts),
        violating_starts=len(violating),
        least=least and least[0],
        rollout=least and str(RolloutId(least[1], least[2], variant, least[3])),
    )


class _Batch(NamedTuple):
    """A row of the table `rollouts` of an observed test, or of an observed block."""

    problem: str
    test: int
    replicate: int
    replicates: int
    places: int
    rollouts: int
    violations: int
    robustness: float
    values: bytes
    """float64; NaN for a rollout that failed."""
    starts: bytes
    """float64, of each test of the block."""
    tests: int
    """Of the block."""
    first: int
    """The place of its first test in the block."""


def _batches(connection: sqlite3.Connection, variant: str, series: list[str]) -> Iterator[_Batch]:
    for row in connection.execute(_BATCHES, [variant, json.dumps(series)]):
        *same, robustness, values, x, starts, tests, first = row
        if starts is None:
            start = json.loads(x)
            starts = struct.pack(f"<{len(start)}d", *start)
        yield _Batch._make([*same, robustness, values or struct.pack("<d", robustness), starts, tests, first])


def read_number_of_rollouts(directory: Path) -> int:
    """Return how many rollouts are recorded, of whatever variant and purpose, with a robustness or without.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        return int(connection.execute(_RECORDED).fetchone()[0])


def read_ranked(directory: Path, variant: str, problems: Sequence[str]) -> RankedRollouts | None:
    """Return the worst, the median and the best rollout of a variant; None if none of it has a robustness.

    The first violation is that of the first series in the order of `read_values`.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        series = sorted(_new_series(connection), key=lambda name: series_order(problems, name))
        which = [variant, json.dumps(series)]
        (number,) = connection.execute(_NUMBER, which).fetchone()
        if not number:
            return None
        worst, median = (connection.execute(_NTH, [*which, place]).fetchone() for place in (0, (number - 1) // 2))
        best = connection.execute(_BEST, which).fetchone()
        firsts = (connection.execute(_FIRST, [variant, json.dumps([name])]).fetchone() for name in series)
        first = next(filter(None, firsts), None)
    return RankedRollouts(
        number,
        _ranked(variant, worst),
        _ranked(variant, median),
        _ranked(variant, best),
        first and _ranked(variant, first),
    )


def _ranked(variant: str, row: tuple[str, int, int, float]) -> RankedRollout:
    problem, test, replicate, robustness = row
    return RankedRollout(RolloutId(problem, test, variant, replicate), robustness)


def read_violating_starts(directory: Path) -> list[StartViolations]:
    """Return the starts with rollouts of any variant that violate the specification.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        rows = connection.execute(_STARTS, [json.dumps(_new_series(connection))]).fetchall()
    return [StartViolations(*row) for row in rows]


def read_values(directory: Path, variant: str, problems: Sequence[str]) -> Iterator[RolloutValue]:
    """Yield the rollouts of a variant: those of the problems in the order of the file, then those of closing checks.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        for series in sorted(_new_series(connection), key=lambda name: series_order(problems, name)):
            for test, replicate, start, robustness in connection.execute(_VALUES, [variant, json.dumps([series])]):
                yield RolloutValue(series, test, replicate, start, robustness)


def is_repeated(directory: Path, rollout: str) -> bool:
    """Whether a recheck repeated a rollout and got the same trajectory.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        rows = connection.execute(_SAME, RolloutId.parse(rollout)).fetchall()
    return any(closing_check(problem) == RECHECK for (problem,) in rows)


def _new_series(connection: sqlite3.Connection) -> list[str]:
    """Return the problems and closing checks whose rollouts are new ones, with a seed of their own.

    Those of a recheck repeat others, and those of the bisection have the seed of the counterexample, which was chosen
    because it fails: each of them would count this seed once more.
    """
    names = [str(name) for (name,) in connection.execute(_SERIES)]
    return [name for name in names if closing_check(name) not in (RECHECK, SHRINK)]
