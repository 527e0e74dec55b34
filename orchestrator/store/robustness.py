"""The robustness of the rollouts behind the bounds and in the closing checks of a campaign, in test order.

The queries go to the SQLite driver directly, as those of `progress`: `perfbound list` reads many campaigns.
"""

import itertools
import json
import math
import sqlite3
from array import array
from collections.abc import Iterable, Iterator, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple

from ...schemas.ids import IMPORTANCE, RECHECK, SHRINK, SIMPLEST, RolloutId, closing_check, series_order
from ...schemas.ranges import LARGEST_BATCH
from ...schemas.result.known import Violations
from .readonly import snapshot

_SERIES = "SELECT DISTINCT problem FROM tests"
# A test without an observation is under way, and which of its rollouts came first may depend on their outcome. A
# rollout that failed in its batch comes after it.
_OBSERVED = """
    FROM rollouts r JOIN tests t ON t.problem = r.problem AND t.test = r.block
    JOIN observations o ON o.problem = r.problem AND o.test = r.block
    WHERE r.problem = ?1 AND r.variant = ?2 AND r.robustness IS NOT NULL
"""
_ROWS = f"""
    SELECT r.problem, r.block, t.tests, t.x, t.starts, r.test, r.replicate, r.replicates, r.robustness, r.robustness_of
    {_OBSERVED}
"""
_IN_ORDER = "ORDER BY r.block, r.places DESC, r.test"
_BATCHES = f"{_ROWS} {_IN_ORDER}"
_WORST = f"{_ROWS} AND r.block = (SELECT min(r.block) {_OBSERVED} AND r.robustness = ?3) {_IN_ORDER}"
_HAS_VIOLATIONS = "AND r.block IN (SELECT block FROM rollouts WHERE problem = ?1 AND violations > 0)"
_VIOLATING = f"{_ROWS} {_HAS_VIOLATIONS} {_IN_ORDER}"
_SUMS = f"SELECT total(r.rollouts), total(r.violations), min(r.robustness) {_OBSERVED}"
_SINGLE_STARTS = f"SELECT DISTINCT t.x {_OBSERVED} AND t.starts IS NULL"
_BLOCKS = f"SELECT DISTINCT t.test, t.tests {_OBSERVED} AND t.starts IS NOT NULL"
_RECORDED = "SELECT total(rollouts) FROM rollouts"

# A recheck observes 1 where both trajectories agree; their files differ, because each names its rollout.
_SAME = """
    SELECT again.problem FROM each_rollout AS one JOIN each_rollout AS again USING (variant, seed)
    JOIN observations ON observations.problem = again.problem AND observations.test = again.test
    WHERE one.problem = ? AND one.test = ? AND variant = ? AND one.replicate = ? AND y = 1
"""


class ObservedValues(NamedTuple):
    """The clipped robustness of the rollouts of one variant at consecutive tests of a series."""

    series: str
    test: int
    """The first of them."""
    starts: bytes
    """float64, of each test."""
    replicates: int
    """Of each test."""
    robustness: "array[float]"
    """Of each test and replicate; NaN where there is none."""

    @property
    def tests(self) -> int:
        """Number of tests."""
        return len(self.robustness) // self.replicates

    def start(self, place: int) -> bytes:
        """Return the start of the test in a place, equal for equal starts."""
        width = len(self.starts) // self.tests
        return self.starts[width * place : width * (place + 1)]

    def each(self, places: Iterable[int] | None = None) -> Iterator[tuple[int, bytes, list[float]]]:
        """Yield number and start of every test with a robustness, and those of its rollouts that have one.

        With `places` the tests in these places alone.
        """
        for place in range(self.tests) if places is None else places:
            values = self.robustness[place * self.replicates : (place + 1) * self.replicates]
            if found := [value for value in values if value == value]:  # noqa: PLR0124  (NaN: it has none)
                yield self.test + place, self.start(place), found

    def places_of(self, starts: Set[bytes]) -> list[int]:
        """Return the places of the tests at one of these starts."""
        width = len(self.starts) // self.tests
        parts = range(0, len(self.starts), width)
        return [place for place, k in enumerate(parts) if self.starts[k : k + width] in starts]

    def below_zero(self) -> list[int]:
        """Return the places of the tests with a rollout below 0."""
        return sorted({place // self.replicates for place, value in enumerate(self.robustness) if value < 0.0})

    def rollout(self, variant: str, place: int) -> RolloutId:
        """Return the rollout of the robustness in a place."""
        test, replicate = divmod(place, self.replicates)
        return RolloutId(self.series, self.test + test, variant, replicate)


def read_violations(directory: Path, variant: str) -> Violations:
    """Return how many rollouts of a variant violate the specification.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    rollouts = violations = starts = 0
    single, violating = set[str](), set[bytes]()
    worst: list[tuple[float, str]] = []
    with snapshot(directory) as connection:
        for name in _new_series(connection):
            # Sums of rows, and only blocks with a violation one by one: a campaign may have a million rollouts.
            of_series = [name, variant]
            here, below, least = connection.execute(_SUMS, of_series).fetchone()
            rollouts, violations = rollouts + int(here), violations + int(below)
            starts += sum(tests for _, tests in connection.execute(_BLOCKS, of_series))
            single.update(x for (x,) in connection.execute(_SINGLE_STARTS, of_series))
            if least is not None:
                worst.append((float(least), name))
            for found in _of_series(connection, _VIOLATING, of_series) if below else ():
                violating.update(map(found.start, found.below_zero()))
        least, name = min(worst, default=(None, ""))
        rollout = None if least is None else _worst_rollout(connection, variant, least, name)
    return Violations(
        rollouts=rollouts,
        violations=violations,
        starts=starts + len(single),
        violating_starts=len(violating),
        least=least,
        rollout=rollout,
    )


def _worst_rollout(connection: sqlite3.Connection, variant: str, least: float, name: str) -> str:
    """Return the first rollout of a series with this robustness."""
    (found,) = _of_series(connection, _WORST, [name, variant, least])
    return str(found.rollout(variant, found.robustness.index(least)))


def read_number_of_rollouts(directory: Path) -> int:
    """Return how many rollouts are recorded, of whatever variant and purpose, with a robustness or without.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        return int(connection.execute(_RECORDED).fetchone()[0])


def read_values(directory: Path, variant: str, problems: Sequence[str]) -> Iterator[ObservedValues]:
    """Yield the tests of a variant: those of the problems in the order of the file, then those of closing checks.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        series = sorted(_new_series(connection), key=lambda name: series_order(problems, name))
        for name in series:
            yield from _of_series(connection, _BATCHES, [name, variant])


def _of_series(connection: sqlite3.Connection, query: str, keys: Sequence[Any]) -> Iterator[ObservedValues]:
    """Yield the tests in the rows of a query, whose first key is the series."""
    rows = connection.execute(query, keys)
    for (block, tests, x, starts), batches in itertools.groupby(rows, key=lambda row: row[1:5]):
        packed = array("d", json.loads(x)).tobytes() if starts is None else starts
        yield ObservedValues(keys[0], block, packed, *_joined(block, tests, [row[5:] for row in batches]))


def _joined(block: int, tests: int, batches: Sequence[Any]) -> "tuple[int, array[float]]":
    """Return the replicates of a test, and the robustness in the batches of a block, of each test and replicate."""
    each = max(replicate + replicates for _, replicate, replicates, _, _ in batches)
    found = [array("d", [robustness]) if packed is None else array("d", packed) for *_, robustness, packed in batches]
    # Before memory is taken: the numbers of a damaged database may be any.
    if tests * each > sum(map(len, found)) + LARGEST_BATCH:
        raise ValueError(f"most rollouts of test {block} are missing")
    values = array("d", [math.nan]) * (tests * each)
    for (test, replicate, *_), batch in zip(batches, found, strict=True):
        first = (test - block) * each + replicate
        values[first : first + len(batch)] = batch
    if len(values) != tests * each:
        raise ValueError(f"the batches of test {block} have more rollouts than it")
    return each, values


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

    Those of a recheck repeat others, those of the bisection have the seed of the counterexample, which was chosen
    because it fails, so that each of them would count this seed once more, as do those of the simplest failures; and
    importance sampling draws around it.
    """
    names = [str(name) for (name,) in connection.execute(_SERIES)]
    return [name for name in names if closing_check(name) not in (RECHECK, SHRINK, IMPORTANCE, SIMPLEST)]
