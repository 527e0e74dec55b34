"""How likely a failure is at the start of the likeliest one: rollouts with disturbances around its."""

from array import array
from collections.abc import Callable

import numpy as np

from ....schemas.draws.laws import coordinate
from ....schemas.ids import IMPORTANCE, RolloutId
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ....schemas.values import Bound, Proposal
from ...mathematics.bounds.one_law.weighted import DEFENSIVE, importance_weight, weighted_failure_lower
from .. import state
from ..observation import Observer
from ..region import Start
from ..seeds import Floats, rollout_seed, uniform
from ..series import Series
from .after_counterexample import AfterCounterexample
from .likeliest import LikeliestFailure
from .spot_check import LEVEL, WINDOW

REACH = 8.0
"""Scores that a law is asked for: beyond, the distribution function is 1 in doubles, and a value infinite."""


class ImportanceSampling(AfterCounterexample):
    """The decider of these tests: each has the start of the likeliest failure, and disturbances of its own.

    One in ten tests has disturbances as in operation, and the others have scores around those of the failure; choices
    follow their law. Which start, and around what, is known before the first of them, so that their bound needs no
    union.
    """

    name = IMPORTANCE

    def __init__(self, header: Header, found: RolloutFact, sought: LikeliestFailure, observer: Observer) -> None:
        super().__init__(found, observer)
        falsify = header.config.falsify
        assert falsify is not None, "the file asks for it"
        self._header, self.start = header, sought.best[0]
        self._scored = sought.scored
        self._laws: dict[int, Callable[[Floats], Floats]] = {}
        self.weights = array("d")
        """Of the rollouts that fail."""
        rollouts = ((found.rollout.variant, 0),)
        self.plan = state.Plan(self.name, WINDOW, falsify.importance_tests, rollouts)

    def proposal(self, series: Series, test: int) -> ProposalFact:  # noqa: ARG002  (no test depends on another)
        """Return the next test."""
        return ProposalFact(self.name, test, Proposal(test, self._start(test), None, None, None, None))

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:
        """Take a robustness; the tests end with their budget."""
        if fact.observation.y < 0.0:
            assert series.last_proposal is not None
            self.weights.append(self._weight(series.last_proposal.x))
        return BoundFact(self.name, fact.test, Bound(None, None, None), budget=fact.test + 1 >= self.plan.max_tests)

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of a rollout."""
        return rollout_seed(self._header, rollout)

    def lower(self, count: int) -> float:
        """Return a lower bound of the probability of a failure at the start, after so many tests: all of them."""
        return weighted_failure_lower(self.weights, count, LEVEL)

    def _start(self, test: int) -> Start:
        laws = self._laws = self._laws or _laws(self._header)
        (shares,) = uniform(self._header, f"{self.name}.starts", range(test, test + 1), 1 + len(laws))
        start, moved = list(self.start), shares[0] >= DEFENSIVE
        for share, (place, drawn) in zip(shares[1:], laws.items(), strict=True):
            (value,) = drawn(np.array([share])).tolist()
            if moved and place in self._scored:
                value += self.start[place]
            start[place] = min(max(value, -REACH), REACH) if place in self._scored else value
        return tuple(start)

    def _weight(self, start: Start) -> float:
        scores = [start[place] for place in self._scored]
        # At the reach more than one draw is the same start, whose density is not that of one.
        if max(map(abs, scores), default=0.0) >= REACH:
            return 0.0
        return importance_weight(scores, [self.start[place] for place in self._scored])


def _laws(header: Header) -> dict[int, Callable[[Floats], Floats]]:
    """Return what draws the scores, or the choices, of each disturbance, by its place in a start."""
    first, spec = len(header.spec.own_parameters), header.spec
    laws = {law.name: law for law in spec.disturbances}
    return {first + k: coordinate(laws[name]) for k, name in enumerate(spec.as_parameters)}
