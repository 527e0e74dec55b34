"""The counterexample nearest to a nominal start on the way to it, by bisection; no claim uses these rollouts."""

import numpy as np

from ....schemas.ids import SHRINK, RolloutId
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Bound, Observation, Proposal
from ...mathematics.gp.kernels import Floats
from .. import state
from ..decisions import UNOBSERVABLE, naming
from ..observation import Observer, Others, Trajectories
from ..region import Start, condition
from ..series import Series
from ..starts import of_space

CLOSE = 1e-3
"""The bisection ends when passing and failing start are this share of the way apart."""


class Shrink:
    """The decider of the bisection: test 0 is at the nominal start, each later one in the middle of what is left.

    Every rollout has variant and seed of the counterexample, so that the start alone differs. Where a failing start
    lies behind a passing one the bisection finds one of the borders; a start outside the region counts as one that
    passes. The last failing start so far is the answer at any moment.
    """

    name = SHRINK

    def __init__(self, header: Header, found: RolloutFact, start: Start, observer: Observer) -> None:
        falsify = header.config.falsify
        assert falsify is not None, "the file asks for it"
        self._found, self._observer = found, observer
        self._space = of_space(header)
        names = [parameter.name for parameter in header.spec.parameters]
        self._region = condition(header.config.where, names)
        low, high = self._space.box
        middle = zip(names, ((low + high) / 2).tolist(), strict=True)
        self.nominal = self._nearest(np.array([falsify.nominal.get(name, value) for name, value in middle]))
        self._passing, self._failing = 0.0, 1.0
        self._starts: dict[float, Start] = {0.0: self.nominal, 1.0: start}
        self.best: tuple[Start, float, RolloutId] = (start, found.robustness or 0.0, found.rollout)
        """The failing start next to one that passes, its robustness and its rollout."""
        self._next: float | None = 0.0
        self._skip_outside()
        budget = falsify.shrink_tests if self._is_open else 0
        variant = found.rollout.variant
        self.plan = state.Plan(SHRINK, 1, budget, ((variant, 0),))

    def proposal(self, series: Series, test: int) -> ProposalFact:  # noqa: ARG002  (one test at a time)
        """Return the start in the middle between what passes and what fails."""
        assert self._next is not None, "a bisection that is complete has ended"
        return ProposalFact(SHRINK, test, Proposal(test, self._starts[self._next], None, None, None, None))

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
        """Halve what is left of the way."""
        assert self._next is not None
        place, fails = self._next, fact.observation.y < 0
        if fails:
            variant = self._found.rollout.variant
            self.best = self._starts[place], fact.observation.y, RolloutId(SHRINK, fact.test, variant, 0)
        self._go_on(place, fails=fails)
        self._skip_outside()
        done = self._next is None
        spent = not done and fact.test + 1 >= self.plan.max_tests
        return BoundFact(SHRINK, fact.test, Bound(None, None, "converged" if done else None), budget=spent)

    def seed(self, rollout: RolloutId) -> int:  # noqa: ARG002  (the same for all)
        """Return the seed of the counterexample."""
        return self._found.seed

    @property
    def _is_open(self) -> bool:
        return self._next is not None

    def _go_on(self, place: float, *, fails: bool) -> None:
        """Take the outcome at a place of the way, and choose the next one."""
        if fails:
            self._failing = place
        else:
            self._passing = place
        middle = (self._passing + self._failing) / 2
        start = self._nearest(self._at(middle))
        ends = self._starts[self._passing], self._starts[self._failing]
        # The nominal start itself fails, or no allowed start is left in between.
        over = self._failing == 0.0 or self._failing - self._passing <= CLOSE or start in ends
        self._next = None if over else middle
        self._starts[middle] = start

    def _skip_outside(self) -> None:
        while self._next is not None and self._region is not None and not self._region([self._starts[self._next]])[0]:
            self._go_on(self._next, fails=False)

    def _at(self, place: float) -> Floats:
        nominal, start = np.array(self._starts[0.0]), np.array(self._starts[1.0])
        found: Floats = nominal + place * (start - nominal)
        return found

    def _nearest(self, point: Floats) -> Start:
        return self._space.nearest(point, ())[1]
