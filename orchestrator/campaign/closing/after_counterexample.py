"""What follows a counterexample: rollouts of its variant at other starts, of which no claim makes use."""

from abc import ABC, abstractmethod

import numpy as np

from ....schemas.ids import SHRINK, RolloutId
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Bound, Observation, Proposal
from .. import state
from ..decisions import UNOBSERVABLE, naming
from ..observation import Observer, Others, Trajectories
from ..region import Start, condition
from ..series import Series
from ..starts import of_space


class AfterCounterexample:
    """What the deciders of these tests have in common: the robustness is what a test observes."""

    name: str
    plan: state.Plan
    """Of at most so many tests, none where there is nothing to try."""

    def __init__(self, found: RolloutFact, observer: Observer) -> None:
        self.found, self._observer = found, observer

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Return the robustness of the rollout."""
        (trajectory,) = trajectories.values()
        with naming(f"{self.name}, test {test}", UNOBSERVABLE):
            robustness = self._observer.robustness(trajectory)
        assert robustness is not None, "a counterexample is one of the robustness"
        found = Observation(robustness, (robustness,))
        return ObservationFact(self.name, test, found, series.next_link(test, found))

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:
        """Do nothing: the robustness of every rollout is computed when it is admitted."""


def nominal_start(header: Header) -> Start:
    """Return the allowed start with the nominal values of the file, and elsewhere the middle of each range."""
    falsify, space = header.config.falsify, of_space(header)
    low, high = space.box
    middle = zip((parameter.name for parameter in header.spec.parameters), ((low + high) / 2).tolist(), strict=True)
    given = {} if falsify is None else falsify.nominal
    return space.nearest(np.array([given.get(name, value) for name, value in middle]), ())[1]


class Improvement(AfterCounterexample, ABC):
    """The decider of tests with the seed of the counterexample: each start follows from the outcomes before it.

    A subclass ends its construction with `_planned`.
    """

    name = SHRINK

    def __init__(self, header: Header, found: RolloutFact, observer: Observer) -> None:
        super().__init__(found, observer)
        self._space = of_space(header)
        self._region = condition(header.config.where, [each.name for each in header.spec.parameters])

    def _planned(self, tests: int) -> state.Plan:
        """Return the plan of at most so many tests."""
        return state.Plan(SHRINK, 1, tests if self.next_start is not None else 0, ((self.found.rollout.variant, 0),))

    @property
    @abstractmethod
    def next_start(self) -> Start | None:
        """The start of the next test; None where nothing is left to try."""

    @abstractmethod
    def _take(self, margin: float, rollout: RolloutId) -> None:
        """Take the robustness at the next start, and choose the one after it."""

    def proposal(self, series: Series, test: int) -> ProposalFact:  # noqa: ARG002  (one test at a time)
        """Return the next test."""
        start = self.next_start
        assert start is not None, "a search that is complete has ended"
        return ProposalFact(SHRINK, test, Proposal(test, start, None, None, None, None))

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:  # noqa: ARG002  (nothing is bounded)
        """Choose the next start."""
        self._take(fact.observation.y, RolloutId(SHRINK, fact.test, self.found.rollout.variant, 0))
        done = self.next_start is None
        spent = not done and fact.test + 1 >= self.plan.max_tests
        return BoundFact(SHRINK, fact.test, Bound(None, None, "converged" if done else None), budget=spent)

    def seed(self, rollout: RolloutId) -> int:  # noqa: ARG002  (the same for all)
        """Return the seed of the counterexample."""
        return self.found.seed
