"""Tests of the assumptions of a problem that need its closed tests alone, at any moment of the campaign.

The audit of the certificate makes them at the end; a campaign that ends where an assumption is refuted makes them after
every test. Each is valid at every moment, also at one that depends on the outcomes.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

from ..mathematics.bounds.checks import audit
from ..mathematics.bounds.checks.audit import Finding
from ..mathematics.bounds.checks.stationarity import AdaptiveOrderTest
from .account import Account
from .plan import ProblemPlan

ROUNDING = 1e-9
"""A gap that dominates may be exceeded by so much in the last digits."""


def same_values(account: Account) -> Finding:
    """Test that rollouts at one start agree bit by bit: of a problem without noise."""
    places = sorted(zip(account.nodes, account.each, strict=True))
    by_place = itertools.groupby(places, key=lambda place: place[0])
    return audit.deterministic_variant([[value for _, each in group for value in each] for _, group in by_place])


def spread(account: Account, delta: float) -> Finding | None:
    """Test the noise scale against the spread of replicates; None where no test has two."""
    plan = account.plan
    # The budget, not the number of tests made: the test is valid at every N only with a constant fixed beforehand.
    planned = plan.budget * plan.replicates
    return audit.replicate_spread(account.each, noise_scale=plan.noise_per_rollout, delta=delta, planned=planned)


def is_dominated(excess: float) -> bool:
    """Whether the gap, times its constant, was at least the robustness difference of every pair of rollouts."""
    return excess <= ROUNDING


@dataclass(slots=True)
class OneLaw:
    """The test that the rollouts of a start have one law during the campaign; each closed test is taken once."""

    plan: ProblemPlan
    taken: int = 0
    _order: AdaptiveOrderTest = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a value."""
        # A list of starts is fixed beforehand; on a box nobody knows how many candidates are tested twice. Drawn starts
        # are one column: where start and rollout have one law, so have the values.
        self._order = AdaptiveOrderTest(starts=1 if self._drawn else self.plan.listed)

    @property
    def _drawn(self) -> bool:
        return self.plan.candidates is None

    def finding(self, nodes: Sequence[int], each: Sequence[Sequence[float]]) -> Finding:
        """Take the closed tests that are new, and return the finding about all of them."""
        for test in range(self.taken, len(nodes)):
            if self._drawn and not self.plan.is_drawn(test):
                continue  # a search chose it by the outcomes before
            for value in each[test][:1] if self._drawn else each[test]:
                self._order.observe(0 if self._drawn else nodes[test], test, value)
        self.taken = len(nodes)
        return self._order.finding()
