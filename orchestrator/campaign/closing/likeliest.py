"""The likeliest failure, from the counterexample of a search over disturbances."""

import numpy as np

from ....schemas.ids import RolloutId
from ....schemas.result.facts import Header, RolloutFact
from ....schemas.system import SCORED
from ...mathematics.search.likeliest import Likeliest
from ..observation import Observer
from ..region import Start
from .after_counterexample import Improvement


class LikeliestFailure(Improvement):
    """The search: each test follows from the margins of those before it, the counterexample first.

    Start and disturbances alone differ from it. Choices stay as they are. A start outside the region counts as one that
    passes.
    """

    def __init__(self, header: Header, found: RolloutFact, start: Start, observer: Observer) -> None:
        super().__init__(header, found, observer)
        falsify, parameters = header.config.falsify, header.spec.parameters
        assert falsify is not None, "the file asks for it"
        first = len(header.spec.own_parameters)
        self.scored = [k for k, each in enumerate(parameters) if k >= first and each.unit == SCORED]
        low, high = (ends.tolist() for ends in self._space.box)
        for k in range(first, len(parameters)):
            if k not in self.scored:
                low[k] = high[k] = start[k]
        self._search = Likeliest(start, found.robustness or 0.0, low, high, self.scored)
        self._tests = self._search.tests()
        self._rollouts = {start: (found.rollout, found.robustness or 0.0)}
        self._next: Start | None = self._admitted(next(self._tests, None))
        self.plan = self._planned(falsify.likeliest_tests)

    @property
    def next_start(self) -> Start | None:
        """The start of the next test of the search."""
        return self._next

    @property
    def best(self) -> tuple[Start, float, RolloutId]:
        """The likeliest failing start, its robustness and its rollout."""
        rollout, robustness = self._rollouts[self._search.best]
        return self._search.best, robustness, rollout

    @property
    def distance(self) -> float:
        """Its distance from the medians of the disturbances, in sd."""
        return self._search.distance

    def _take(self, margin: float, rollout: RolloutId) -> None:
        """Give the margin to the search."""
        assert self._next is not None
        if margin < 0.0:
            self._rollouts.setdefault(self._next, (rollout, margin))
        self._next = self._admitted(self._sent(self._next, margin))

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
