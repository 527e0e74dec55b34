"""A control with a known mean: values of rollouts, less what their disturbances explain of them.

| symbol | name       | meaning                                                                     | shape   | unit   |
|--------|------------|-----------------------------------------------------------------------------|---------|--------|
| k      |            | disturbances                                                                | ()      | -      |
| d      | `starts`   | start, as shares of the ranges, from -1 to 1                                | (n, p)  | -      |
| t      | `scores`   | scores of the disturbances, see `basis`                                     | (n, k)  | -      |
| x      | `x`        | value of a rollout                                                          | (n,)    | unit X |
| g      |            | sum_i sum_j (beta_ij + sum_l d_l gamma_ijl) (H_ij(t_i) - p_ij)              | (n,)    | unit X |

Given the start, E g = 0 exactly, because every H_ij has the known mean p_ij. With beta and gamma from earlier tests
alone, x - g has, given the past, the mean of x; it is in [a - max g, b - min g] where x is in [a, b], and the largest
and the least g of a start are sums over the disturbances of the extremes at the knots. Nothing about g has to be true:
a bad one costs variance, and never validity.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..gp.kernels import Floats
from .basis import Basis
from .fit import MOST_ROLLOUTS, PENALTIES, RIDGE, Sums, Within, roughness

MOST_FIRST, LEAST_FIRST, FIRST_SHARE = 64, 32, 16
"""Rollouts of the first fit: a sixteenth of the budget, between these; each further fit is at twice as many."""
MOST_FUNCTIONS = 200
"""Of the disturbances in a fit: beyond it there are no products with the start."""
SLACK = 1e-12
"""Of a range, by which the sums of a control may be rounded."""
EXPECTED = 0.6
"""Of the noise that the first fit leaves, what later ones leave; 1.2 lost 0.004 of the bound of 1,000 rollouts."""


@dataclass(frozen=True)
class Control:
    """One fitted control."""

    bases: tuple[Basis, ...]
    levels: tuple[Floats, ...]
    """For each disturbance beta and gamma (1 + p, m): the part of g at a knot is that of the start (1, d)."""
    residual: float
    """Standard deviation that x - g had on rollouts of which the fit knew nothing; unit X."""
    before: float
    """The same of x, less what its start explains."""

    def times(self, factor: float) -> "Control":
        """Return that of x times a factor."""
        levels = tuple(factor * each for each in self.levels)
        return Control(self.bases, levels, factor * self.residual, factor * self.before)

    def values(self, starts: Floats, scores: Floats) -> tuple[Floats, Floats, Floats]:
        """Return g, and the least and the largest g at each start, (n,) each.
        Implements eq. (control) of [PB].

        Formula: at the head of this module.
        """
        weights = np.hstack([np.ones((len(starts), 1)), starts])
        g, low, high = (np.zeros(len(starts)) for _ in range(3))
        for i, (basis, levels) in enumerate(zip(self.bases, self.levels, strict=True)):
            at_knots = weights[:, : len(levels)] @ levels
            mean = at_knots @ basis.means
            g += np.sum(at_knots * basis.hats(scores[:, i]), axis=1) - mean
            low += at_knots.min(axis=1) - mean
            high += at_knots.max(axis=1) - mean
        return g, low, high

    @property
    def explained(self) -> float:
        """The share of the variance of x that it took out of rollouts of which the fit knew nothing."""
        return max(1.0 - (self.residual / self.before) ** 2, 0.0)

    @property
    def deviations(self) -> tuple[float, ...]:
        """The standard deviation of the part of each disturbance in g, over uniform starts; unit X."""
        # Shares of a range are uniform on [-1, 1]: their mean is 0, that of their squares and products 1/3 and 0.
        parts = zip(self.bases, self.levels, strict=True)
        variances = ([basis.variance(each) for each in levels] for basis, levels in parts)
        return tuple((middle + sum(others) / 3.0) ** 0.5 for middle, *others in variances)


def first_fit(rollouts: int) -> int:
    """Return after how many of so many rollouts the first control is fitted.

    >>> first_fit(100), first_fit(640), first_fit(6400)
    (32, 40, 64)

    """
    return min(max(rollouts // FIRST_SHARE, LEAST_FIRST), MOST_FIRST)


@dataclass(frozen=True)
class Disturbed:
    """The declared disturbances of the rollouts of one problem."""

    bases: tuple[Basis, ...]
    scores: Callable[[int, Floats], Floats]
    """(number of a test among those that the method observes, what its rollouts report (b, m)) -> scores (b, k)."""
    planned: int = 1
    """Number of values that are planned, where each is bounded as one of one law."""
    reported: int = 0
    """Disturbances m that a rollout reports."""

    def split(self, each: Floats, parts: int = 1) -> tuple[Floats, Floats]:
        """Return the values (n, parts b) in the contributions (n, w) to tests, and what is reported at their end.

        The latter has the shape (n, b, m): that of b rollouts, each with a value for every part.
        """
        rollouts = each.shape[1] // (parts + self.reported)
        values = each[:, : parts * rollouts]
        return values, each[:, parts * rollouts :].reshape(len(each), rollouts, self.reported)


class ControlSequence:
    """The controls of one value: each is fitted on the tests before those that it serves.

    `ends` is the range of x. Rollouts enter in test order; between two fits the control stays.
    """

    def __init__(self, bases: Sequence[Basis], parameters: int, ends: tuple[float, float], first: int) -> None:
        self._bases, self._low, self._range = tuple(bases), ends[0], ends[1] - ends[0]
        widths = [len(basis.knots) for basis in bases]
        self._parameters = parameters
        self._products = sum(widths) * (1 + parameters) <= MOST_FUNCTIONS
        copies = 1 + parameters * self._products
        self._width = sum(widths) * copies
        self._penalty, self._ridge = np.zeros((self._width,) * 2), np.zeros((self._width,) * 2)
        self._plain, place = sum(widths), 0
        for _ in range(copies):
            for width in widths:
                block = slice(place, place + width)
                self._penalty[block, block] = roughness(width)
                place += width
        self._ridge.flat[:: self._width + 1] = RIDGE
        self._sums, self._half, self._next = Sums.empty(self._width), Sums.empty(self._width), first
        self._first = first
        self.has_begun = False
        """Whether there has been a fit."""
        self.control: Control | None = None
        """None before the first fit, and where the disturbances explain nothing."""

    @property
    def ahead(self) -> int:
        """How many rollouts, at least 1, may enter in one piece or in many with the same fits."""
        look = self._next if self._half.count else self._first // 2
        return look - self._sums.count if look <= MOST_ROLLOUTS else MOST_ROLLOUTS

    def add(self, start: int, places: Floats, scores: Floats, x: Floats) -> bool:
        """Take the rollouts of one test, and fit the control of the following ones where their number is reached.

        `start` is the number of the start, which they share, and `places` (n, p) has it as shares of the ranges. Scores
        (n, b, k) are those of b rollouts, of which x has the means. Return whether there was a fit.
        """
        some = slice(max(MOST_ROLLOUTS - self._sums.count, 0))
        if not len(x[some]):
            return False
        shares = (x[some] - self._low) / self._range
        self._sums = self._sums.plus(start, self._rows(places[some], scores[some]), shares)
        # Where the first test has as many rollouts as a fit, the next one is what its penalty is chosen on.
        fits = self._sums.count >= self._next and self._half.count > 0
        if not self._half.count and self._sums.count >= self._first // 2:
            self._half = self._sums
        if fits:
            self._fit()
            self._half, self._next, self.has_begun = self._sums, 2 * self._sums.count, True
        return fits

    def _rows(self, places: Floats, scores: Floats) -> Floats:
        each = scores.reshape(-1, scores.shape[-1])
        hats = np.hstack([basis.hats(each[:, i]) for i, basis in enumerate(self._bases)])
        if scores.ndim > 2:
            hats = hats.reshape(*scores.shape[:2], -1).mean(axis=1)
        products = [hats * places[:, [axis]] for axis in range(self._parameters)] if self._products else []
        return np.hstack([hats, *products])

    def _fit(self) -> None:
        first, second = self._half.within, self._sums.minus(self._half).within
        none = best = second.variance(np.zeros(self._width))
        chosen = None
        for width in sorted({self._plain, self._width}):
            for penalty in PENALTIES:
                beta = self._padded(first.first(width), penalty)
                if (variance := second.variance(beta)) < best:
                    best, chosen = variance, (width, penalty)
        self.control = None
        if chosen is not None:
            width, penalty = chosen
            beta = self._padded(self._sums.within.first(width), penalty)
            self.control = self._made(beta * self._range, best, none)

    def _padded(self, sums: Within, penalty: float) -> Floats:
        """Return beta of the functions in the sums, and 0 for the others."""
        found, own = np.zeros(self._width), len(sums.moment)
        found[:own] = sums.solved(penalty * self._penalty[:own, :own] + self._ridge[:own, :own])
        return found

    def _made(self, beta: Floats, error: float, before: float) -> Control:
        widths = [len(basis.knots) for basis in self._bases]
        copies = 1 + self._parameters * self._products
        parts = beta.reshape(copies, sum(widths))
        ends = np.cumsum([0, *widths])
        levels = tuple(parts[:, a:b] for a, b in pairwise(ends.tolist()))
        return Control(self._bases, levels, error**0.5 * self._range, before**0.5 * self._range)
