"""The rollouts of a campaign by their robustness: violations by their starts, and the tests to look at first."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ....schemas.ids import RECHECK, closing_check
from ....schemas.result.facts import Header, RolloutFact
from ...campaign.seeds import VARIANTS
from ...mathematics.linkage import NEAR, linked, unit_points
from ...store.robustness import ObservedValues, read_values
from ..data.ranges import ranges
from ..data.rollouts import Rank, RankedTest, StartGroup, ViolatingStart, ViolatingStarts

MOST_COUNTEREXAMPLES = 1000
"""In the data; counterexamples.csv lists all of them."""
MOST_STARTS = 1000
"""Starts in groups, the worst ones: the cost grows with their square."""
Start = Callable[[str, int], tuple[float, ...] | None]
"""The start of a test of a problem or closing check; None for one that was proposed since."""


class ViolationStatistics:
    """Violations and ranks of the rollouts in `directory`; the database is asked again only after new rollouts."""

    def __init__(self, directory: Path) -> None:
        self.worst: list[RolloutFact] = []
        """At most `MOST_COUNTEREXAMPLES` violations, the worst first."""
        self.number = 0
        """Of all violations."""
        self.later = 0
        """Of those in closing checks."""
        self._directory = directory
        self._new = True
        self._ranked: tuple[RankedTest, ...] = ()
        self._violating: ViolatingStarts | None = None

    def add(self, violations: Sequence[RolloutFact], *, changed: bool) -> None:
        """Add new violations; `changed` tells whether there are new rollouts or observations at all."""
        # A recheck repeats rollouts that have been counted.
        new = [fact for fact in violations if closing_check(fact.rollout.problem) != RECHECK]
        self.number += len(new)
        self.later += sum(closing_check(fact.rollout.problem) is not None for fact in new)
        found = sorted([*self.worst, *new], key=lambda fact: (fact.robustness, fact.rollout))
        self.worst = found[:MOST_COUNTEREXAMPLES]
        self._new = self._new or changed

    def refresh(self, header: Header, start: Start) -> None:
        """Rank and group the rollouts again where there are new ones.

        Raises:
            JournalError: the database cannot be read.

        """
        if self._new:
            found = ranked_tests(self._directory, header)
            # The database may have got a test since the facts were read; the next refresh has it.
            self._ranked = tuple(each for each in found if start(each.problem, each.test) is not None)
            self._violating = self._grouped(header, start) if self.number else None
            self._new = False

    @property
    def ranked(self) -> tuple[RankedTest, ...]:
        """The worst test, the first violation, the median and the best one."""
        return self._ranked

    def ranked_of(self, problem: str, test: int) -> frozenset[str]:
        """Return the rollouts of one test that have a rank."""
        return frozenset(each.rollout for each in self._ranked if (each.problem, each.test) == (problem, test))

    @property
    def violating(self) -> ViolatingStarts | None:
        """The starts of all violations in groups."""
        return self._violating

    def _grouped(self, header: Header, start: Start) -> ViolatingStarts:
        found = [
            each for each in violating_starts(self._directory, header) if start(each.problem, each.test) is not None
        ]
        return grouped(found, list(ranges(header).values()))


def violating_starts(directory: Path, header: Header) -> list[ViolatingStart]:
    """Return the starts with rollouts of any variant that violate the specification.

    Raises:
        JournalError: the database cannot be read.

    """
    names = [problem.name for problem in header.config.problems]
    values = [each for variant in VARIANTS for each in read_values(directory, variant, names)]
    violating = {each.start(place) for each in filter(_violates, values) for place in each.below_zero()}
    starts: dict[bytes, ViolatingStart] = {}
    for each in values if violating else ():
        for test, start, found in each.each(each.places_of(violating)):
            x, worst = tuple(np.frombuffer(start).tolist()), min(found)
            before = starts.get(start, ViolatingStart(x, 0, 0, math.inf, each.series, test))
            violations = before.violations + sum(value < 0.0 for value in found)
            after = replace(before, violations=violations, rollouts=before.rollouts + len(found))
            if worst < before.worst:
                after = replace(after, worst=worst, problem=each.series, test=test)
            starts[start] = after
    return list(starts.values())


def ranked_tests(directory: Path, header: Header) -> list[RankedTest]:
    """Return the tests of the worst, the first violating, the median and the best rollout of the tested variant.

    Raises:
        JournalError: the database cannot be read.

    """
    variant = header.claimed_variant
    blocks = list(read_values(directory, variant, [problem.name for problem in header.config.problems]))
    if not blocks:
        return []
    first = next(filter(_violates, blocks), None)
    blocks.sort(key=lambda block: block.series)  # of equal ones that of the first series by name, test and replicate
    values = np.concatenate([np.asarray(block.robustness) for block in blocks])
    ends = np.cumsum([len(block.robustness) for block in blocks])
    order, number = np.argsort(values, kind="stable"), int(np.count_nonzero(~np.isnan(values)))  # NaN comes last

    def ranked(rank: Rank, block: ObservedValues, place: int) -> RankedTest:
        rollout = block.rollout(variant, place)
        return RankedTest(rank, rollout.problem, rollout.test, str(rollout), block.robustness[place], variant, number)

    def at(rank: Rank, place: int) -> RankedTest:
        block = int(np.searchsorted(ends, place, side="right"))
        return ranked(rank, blocks[block], place - int(ends[block]) + len(blocks[block].robustness))

    found = [at("worst", int(order[0]))]
    if first is not None:
        found.append(ranked("first violation", first, int((np.asarray(first.robustness) < 0.0).argmax())))
    return [*found, at("median", int(order[(number - 1) // 2])), at("best", int(np.nanargmax(values)))]


def _violates(values: ObservedValues) -> bool:
    return bool((np.asarray(values.robustness) < 0.0).any())


def grouped(starts: Sequence[ViolatingStart], ranges: Sequence[tuple[float, float]]) -> ViolatingStarts:
    """Return the starts in groups, those with the worst rollouts first; of more than `MOST_STARTS` the others counted.

    Each start of a group is near another one of it, and no two groups have starts that are near each other.

    >>> starts = [ViolatingStart((x,), 1, 2, -x, "p", k) for k, x in enumerate((0.1, 0.15, 0.9))]
    >>> [(group.low, group.high, group.violations, group.rollouts) for group in grouped(starts, [(0.0, 1.0)]).groups]
    [((0.9,), (0.9,), 1, 2), ((0.1,), (0.15,), 2, 4)]
    """
    worst_first = sorted(starts, key=lambda start: (start.worst, start.x))
    kept, others = worst_first[:MOST_STARTS], worst_first[MOST_STARTS:]
    groups: dict[int, list[ViolatingStart]] = {}
    low, high = np.array(ranges, dtype=np.float64).reshape(-1, 2).T
    points = np.array([start.x for start in kept], dtype=np.float64).reshape(len(kept), len(low))
    for start, number in zip(kept, linked(unit_points(points, low, high)), strict=True):
        groups.setdefault(number, []).append(start)
    return ViolatingStarts(
        groups=tuple(map(_group, groups.values())),
        starts=len(starts),
        near=NEAR,
        other_starts=len(others),
        other_violations=sum(start.violations for start in others),
        other_rollouts=sum(start.rollouts for start in others),
    )


def _group(starts: Sequence[ViolatingStart]) -> StartGroup:
    columns = list(zip(*(start.x for start in starts), strict=True))
    return StartGroup(
        low=tuple(map(min, columns)),
        high=tuple(map(max, columns)),
        starts=tuple(starts),
        violations=sum(start.violations for start in starts),
        rollouts=sum(start.rollouts for start in starts),
        worst=starts[0].worst,
    )
