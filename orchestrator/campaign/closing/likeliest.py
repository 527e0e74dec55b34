"""The likeliest failure, from the counterexample of a search over disturbances; no claim uses these rollouts."""

import numpy as np

from ....schemas.ids import SHRINK, RolloutId
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ....schemas.system import SCORED
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Bound, Observation, Proposal
from ...mathematics.search.likeliest import Likeliest
from .. import state
from ..decisions import UNOBSERVABLE, naming
from ..observation import Observer, Others, Trajectories
from ..region import Start, condition
from ..series import Series
from ..starts import of_space


class LikeliestFailure:
    """The decider of the search: each test follows from the margins of those before it, the counterexample first.

    Every rollout has variant and seed of the counterexample, so that start and disturbances alone differ. Choices stay
    as they are. A start outside the region counts as one that passes.
    """

    name = SHRINK

    def __init__(self, header: Header, found: RolloutFact, start: Start, observer: Observer) -> None:
        falsify, parameters = header.config.falsify, header.spec.parameters
        assert falsify is not None, "the file asks for it"
        self._found, self._observer, self._space = found, observer, of_space(header)
        self._region = condition(header.config.where, [each.name for each in parameters])
        first = len(header.spec.own_parameters)
        scored = [k for k, each in enumerate(parameters) if k >= first and each.unit == SCORED]
        low, high = (ends.tolist() for ends in self._space.box)
        for k in range(first, len(parameters)):
            if k not in scored:
                low[k] = high[k] = start[k]
        self._search = Likeliest(start, found.robustness or 0.0, low, high, scored)
        self._tests = self._search.tests()
        self._rollouts = {start: (found.rollout, found.robustness or 0.0)}
        self._next: Start | None = self._admitted(next(self._tests, None))
        variant = found.rollout.variant
        self.plan = state.Plan(SHRINK, 1, falsify.likeliest_tests if self._next else 0, ((variant, 0),))

    @property
    def best(self) -> tuple[Start, float, RolloutId]:
        """The likeliest failing start, its robustness and its rollout."""
        rollout, robustness = self._rollouts[self._search.best]
        return self._search.best, robustness, rollout

    @property
    def distance(self) -> float:
        """Its distance from the medians of the disturbances, in sd."""
        return self._search.distance

    def proposal(self, series: Series, test: int) -> ProposalFact:  # noqa: ARG002  (one test at a time)
        """Return the next test of the search."""
        assert self._next is not None, "a search that is complete has ended"
        return ProposalFact(SHRINK, test, Proposal(test, self._next, None, None, None, None))

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Return the robustness of the rollout."""
        (trajectory,) = trajectories.values()
        with naming(f"{SHRINK}, test {test}", UNOBSERVABLE):
            robustness = self._observer.robustness(trajectory)
        assert robustness is not None, "a counterexample is one of the robustness"
        found = Observation(robustness, (robustness,))
        return ObservationFact(SHRINK, test, found, series.next_link(test, found))

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:
        """Do nothing: the robustness of every rollout is computed when it is admitted."""

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:  # noqa: ARG002  (nothing is bounded)
        """Give the margin to the search."""
        assert self._next is not None
        margin = fact.observation.y
        if margin < 0.0:
            rollout = RolloutId(SHRINK, fact.test, self._found.rollout.variant, 0)
            self._rollouts.setdefault(self._next, (rollout, margin))
        self._next = self._admitted(self._sent(self._next, margin))
        done = self._next is None
        spent = not done and fact.test + 1 >= self.plan.max_tests
        return BoundFact(SHRINK, fact.test, Bound(None, None, "converged" if done else None), budget=spent)

    def seed(self, rollout: RolloutId) -> int:  # noqa: ARG002  (the same for all)
        """Return the seed of the counterexample."""
        return self._found.seed

    def _sent(self, point: Start, margin: float) -> Start | None:
        try:
            return self._tests.send((point, margin))
        except StopIteration:
            return None

    def _admitted(self, point: Start | None) -> Start | None:
        """Return the allowed start next to a point; past the points outside the region, to the next one of those."""
        while point is not None:
            near = self._space.nearest(np.array(point), ())[1]
            if self._region is None or self._region([near])[0]:
                return near
            # It passes, and shows no slope.
            point = self._sent(self._search.best, 0.0)
        return None
