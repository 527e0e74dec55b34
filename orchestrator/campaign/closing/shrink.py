"""The counterexample nearest to a nominal start on the way to it, by bisection."""

import numpy as np

from ....schemas.ids import RolloutId
from ....schemas.result.facts import Header, RolloutFact
from ...mathematics.gp.kernels import Floats
from ..observation import Observer
from ..region import Start
from .after_counterexample import Improvement, nominal_start

CLOSE = 1e-3
"""The bisection ends when passing and failing start are this share of the way apart."""


class Shrink(Improvement):
    """The bisection: test 0 is at the nominal start, each later one in the middle of what is left.

    The start alone differs from the counterexample. Where a failing start lies behind a passing one the bisection finds
    one of the borders; a start outside the region counts as one that passes. The last failing start so far is the
    answer at any moment.
    """

    def __init__(self, header: Header, found: RolloutFact, start: Start, observer: Observer) -> None:
        super().__init__(header, found, observer)
        falsify = header.config.falsify
        assert falsify is not None, "the file asks for it"
        self.nominal = nominal_start(header)
        self._passing, self._failing = 0.0, 1.0
        self._starts: dict[float, Start] = {0.0: self.nominal, 1.0: start}
        self.best: tuple[Start, float, RolloutId] = (start, found.robustness or 0.0, found.rollout)
        """The failing start next to one that passes, its robustness and its rollout."""
        self._next: float | None = 0.0
        self._skip_outside()
        self.plan = self._planned(falsify.shrink_tests)

    @property
    def next_start(self) -> Start | None:
        """The start in the middle between what passes and what fails."""
        return None if self._next is None else self._starts[self._next]

    def _take(self, margin: float, rollout: RolloutId) -> None:
        """Halve what is left of the way."""
        assert self._next is not None
        place, fails = self._next, margin < 0
        if fails:
            self.best = self._starts[place], margin, rollout
        self._go_on(place, fails=fails)
        self._skip_outside()

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
