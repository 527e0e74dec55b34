"""How likely a failure is at the start of the likeliest one: rollouts with disturbances around its."""

from array import array
from functools import cached_property

import numpy as np

from ....schemas.ids import IMPORTANCE, RolloutId
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact
from ....schemas.values import Bound, Proposal
from ...mathematics.bounds.one_law.weighted import DEFENSIVE, importance_weight, weighted_failure_lower
from .. import state
from ..observation import Observer
from ..region import Start
from ..seeds import rollout_seed, uniform
from ..series import Series
from ..starts import Column, drawn_disturbances
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

    def __init__(self, header: Header, sought: LikeliestFailure, observer: Observer) -> None:
        super().__init__(sought.found, observer)
        falsify = header.config.falsify
        assert falsify is not None, "the file asks for it"
        self._header, self.start, self._scored = header, sought.best[0], sought.scored
        self.weights = array("d")
        """Of the rollouts that fail."""
        rollouts = ((self.found.rollout.variant, 0),)
        self.plan = state.Plan(self.name, WINDOW, falsify.sampled_tests, rollouts)

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
        (shares,) = uniform(self._header, f"{self.name}.starts", range(test, test + 1), 1 + len(self._columns))
        start, moved = list(self.start), shares[0] >= DEFENSIVE
        first = len(start) - len(self._columns)
        for place, (share, drawn) in enumerate(zip(shares[1:], self._columns, strict=True), first):
            (value,) = drawn(np.array([share]))
            if moved and place in self._scored:
                value += self.start[place]
            start[place] = min(max(value, -REACH), REACH) if place in self._scored else value
        return tuple(start)

    @cached_property
    def _columns(self) -> list[Column]:
        # Once they are needed: scipy takes a second to load.
        return drawn_disturbances(self._header.spec)

    def _weight(self, start: Start) -> float:
        scores = [start[place] for place in self._scored]
        # At the reach more than one draw is the same start, whose density is not that of one.
        if max(map(abs, scores), default=0.0) >= REACH:
            return 0.0
        return importance_weight(scores, [self.start[place] for place in self._scored])
