"""The rollouts of a campaign by their robustness: violations by their starts, and the tests to look at first."""

from collections.abc import Callable, Sequence
from pathlib import Path

from ....schemas.ids import RECHECK, closing_check
from ....schemas.result.facts import Header, RolloutFact
from ...store.robustness import RankedRollout, read_ranked, read_violating_starts
from ..data.ranges import ranges
from ..data.rollouts import Rank, RankedTest, ViolatingStart, ViolatingStarts
from .start_groups import grouped

Start = Callable[[str, int], tuple[float, ...] | None]
"""The start of a test of a problem or closing check; None for one that was proposed since."""


class ViolationStatistics:
    """Violations and ranks of the rollouts in `directory`; the database is asked again only after new rollouts."""

    def __init__(self, directory: Path) -> None:
        self.facts: list[RolloutFact] = []
        """All violations, the worst first."""
        self._directory = directory
        self._new = True
        self._ranked: tuple[RankedTest, ...] = ()
        self._violating: ViolatingStarts | None = None

    def add(self, violations: Sequence[RolloutFact], *, changed: bool) -> None:
        """Add new violations; `changed` tells whether there are new rollouts or observations at all."""
        # A recheck repeats rollouts that have been counted.
        self.facts += (fact for fact in violations if closing_check(fact.rollout.problem) != RECHECK)
        self.facts.sort(key=lambda fact: (fact.robustness, fact.rollout))
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
            self._violating = self._grouped(header, start) if self.facts else None
            self._new = False

    @property
    def later(self) -> int:
        """Number of violations in closing checks."""
        return sum(closing_check(fact.rollout.problem) is not None for fact in self.facts)

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
            ViolatingStart(x, each.violations, each.rollouts, each.least, each.series, each.test)
            for each in read_violating_starts(self._directory)
            if (x := start(each.series, each.test)) is not None
        ]
        return grouped(found, list(ranges(header).values()))


def ranked_tests(directory: Path, header: Header) -> list[RankedTest]:
    """Return the tests of the worst, the first violating, the median and the best rollout of the tested variant.

    Raises:
        JournalError: the database cannot be read.

    """
    variant = header.claimed_variant
    found = read_ranked(directory, variant, [problem.name for problem in header.config.problems])
    if found is None:
        return []
    each: list[tuple[Rank, RankedRollout | None]] = [
        ("worst", found.worst),
        ("first violation", found.first),
        ("median", found.median),
        ("best", found.best),
    ]
    return [
        RankedTest(rank, at.rollout.problem, at.rollout.test, str(at.rollout), at.robustness, variant, found.number)
        for rank, at in each
        if at is not None
    ]
