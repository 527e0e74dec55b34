"""The control of values of one law, which come one by one: of one start, or of starts that are drawn.

| symbol | name      | meaning                                                                          | shape | unit |
|--------|-----------|----------------------------------------------------------------------------------|-------|------|
| x      | `x`       | values; a fit reads those outside `ends` as the nearest end                      | (n,)  | v    |
| g      | `g`       | sum_i sum_j beta_ij (H_ij(t_i) - p_ij), or its mean over the rollouts of a value | (n,)  | v    |
| N      | `planned` | number of values that are planned                                                | ()    | -    |
| delta  | `delta`   | failure probability of the bound that bets on x - g                              | ()    | -    |

Given the past E g = 0, as in `sequence`, whatever beta was fitted to. So x - g has the mean of x, and is at least the
least x less max g. That is what a bet may lose more, and all that a control costs.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from ..gp.kernels import Floats
from .basis import Basis
from .fit import MOST_ROLLOUTS
from .sequence import EXPECTED, SLACK, Control, ControlSequence, Disturbed, first_fit

PAYS = 0.9
"""Of the loss without a control, what it may be at most with the first one, which rests on few values."""
CAP = 0.95
"""Share of the wealth that the boldest bets may lose at once."""


class LawControl:
    """The control of values of one law, from the values before; it is used if it is expected to pay.

    Values enter in pieces of at most `ahead`, and every division of them into such pieces gives the same controls.
    """

    def __init__(self, disturbed: Disturbed, ends: tuple[float, float], delta: float) -> None:
        self._bases, self._ends = disturbed.bases, ends
        self._planned, self._cost = max(disturbed.planned, 1), math.log(1.0 / delta)
        self._controls = ControlSequence(disturbed.bases, 0, ends, first_fit(disturbed.planned))
        self._levels: tuple[Floats, ...] = ()
        self._is_used = True
        self.least = self.most = 0.0
        """What g is at least and at most, with a slack for rounding; the unit of x."""
        self.before_fit = 0
        """Values before the first fit."""

    @property
    def control(self) -> Control | None:
        """The control of the next values; None before the first fit, and where none explains enough."""
        return self._controls.control if self._is_used else None

    @property
    def has_begun(self) -> bool:
        """Whether there has been a fit."""
        return self._controls.has_begun

    @property
    def ahead(self) -> int:
        """How many values have one control, at least 1."""
        return self._controls.ahead if self._is_used else MOST_ROLLOUTS

    def g(self, scores: Floats) -> Floats:
        """Return g of values with the scores of one rollout each (n, k), or of the b that they are means of (n, b, k).
        Implements eq. (control) of [PB].

        Formula: at the head of this module.
        """
        each = scores.reshape(-1, scores.shape[-1])
        found = np.zeros(len(each))
        for i, levels in enumerate(self._levels):
            # All but two of the functions are 0: no order of the sum changes a digit.
            found += np.sum(self._bases[i].hats(each[:, i]) * levels, axis=1)
        return found if scores.ndim == 2 else found.reshape(scores.shape[:2]).mean(axis=1)

    def add(self, scores: Floats, x: Floats, room: Callable[[], float]) -> bool:
        """Take values that were bet on, and return whether the next ones have another control.

        `room` returns how far the mean of x seems to be above the least x.
        """
        if not self._is_used:
            return False
        if not self.has_begun:
            self.before_fit += len(x)
        had_begun, fits = self.has_begun, False
        while len(x):
            some = slice(self.ahead)
            # All have one start: what a start that is drawn explains is no disturbance.
            fits |= self._controls.add(0, np.empty((len(x[some]), 0)), scores[some], np.clip(x[some], *self._ends))
            scores, x = scores[some.stop :], x[some.stop :]
        if not fits:
            return False
        self._use(self._controls.control)
        if not had_begun and not self._pays(room()):
            self._is_used = False
            self._use(None)
        return True

    def _use(self, control: Control | None) -> None:
        self._levels, self.least, self.most = (), 0.0, 0.0
        if control is not None:
            means = (math.fsum((each[0] * basis.means).tolist()) for each, basis in self._pairs(control))
            self._levels = tuple(each[0] - mean for each, mean in zip(control.levels, means, strict=True))
            slack = SLACK * (self._ends[1] - self._ends[0])
            self.least = math.fsum(float(each.min()) for each in self._levels) - slack
            self.most = math.fsum(float(each.max()) for each in self._levels) + slack

    def _pairs(self, control: Control) -> Sequence[tuple[Floats, Basis]]:
        return tuple(zip(control.levels, self._bases, strict=True))

    def _pays(self, room: float) -> bool:
        """Whether the bound after all planned values is expected to be better with the control."""
        control = self._controls.control
        if control is None:
            return True  # a later fit may find what this one does not, and nothing is lost until then
        return self._loss(EXPECTED * control.residual, room + self.most) < PAYS * self._loss(control.before, room)

    def _loss(self, deviation: float, room: float) -> float:
        """Return how far a bound is expected to be from the mean, to second order, with the best constant bet."""
        cost, variance = self._cost / self._planned, max(deviation**2, 1e-300)
        bet = min(math.sqrt(2.0 * cost / variance), CAP / room)
        return cost / bet + bet * variance / 2.0
