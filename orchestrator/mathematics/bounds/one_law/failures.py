"""Bounds of a failure probability and of a quantile that are valid for all numbers of samples at once.

| symbol | name       | meaning                                                                | shape  | unit |
|--------|------------|------------------------------------------------------------------------|--------|------|
| n, k   | `count`, `failures` | samples so far, and failures among them                       | ()     | -    |
| P      |            | probability that a sample fails, the same for every sample             | ()     | -    |
| p      | `p`        | candidate; the null hypothesis is P >= p, or P <= p for a lower bound  | ()     | -    |
| u      |            | p times u (or p over u) is the probability that is bet on; Beta(a, 1)  | ()     | -    |
| a      | `SHAPE`    | 1/2                                                                    | ()     | -    |
| W      |            | wealth of the bets against p                                           | ()     | -    |
| v_j    | `value`    | value of the j-th sample, also unbounded; large is good                | ()     | v    |
| q      | `share`    | in (0, 1); Q_q = inf{t: P(v <= t) >= q}                                | ()     | -    |
| t_i    | `grid`     | t_1 < t_2 < .. < t_G, fixed beforehand                                 | (G,)   | v    |
| delta  | `delta`    | failure probability of a bound                                         | ()     | -    |

Validity. For theta <= p <= P the factor theta/p after a failure and (1 - theta)/(1 - p) after a success have a mean of
at most 1. Their product is a bet against P >= p, and the mean of the products over theta = p u, u ~ Beta(a, 1), is

    W(p) = int_0^1 u^k ((1 - p u)/(1 - p))^(n - k) a u^(a - 1) du
         = a p^-(k + a) (1 - p)^(k - n) B(k + a, n - k + 1) I_p(k + a, n - k + 1),

a supermartingale that starts at 1: by Ville P[some n: W(p) >= 1/delta] <= delta. Against P <= p the products are those
of theta = p/u where p <= u <= 1; what u < p would bet is not bet, so that this W starts at 1 - p^a:

    W(p) = a p^(a - k) (1 - p)^(k - n) B(k - a, n - k + 1) (1 - I_p(k - a, n - k + 1))               (k >= 1; else < 1)

The law of u is the same for every p. So every product rises in p in the first W and falls in the second, the rejected
candidates are an interval at an end of (0, 1), and one root is the bound: no grid, no union. Also, W(p) depends on n p
and k alone where failures are rare, so that the price of all n at once is the same at every n. Among powers of u that
of Jeffreys, theta^(-1/2) for the rate of rare events, is the usual compromise: a larger a loses without failures, where
u near 0 is best, and a smaller one with failures.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from ...gp.kernels import Floats
from ..rounding import ROUND_OFF, STEP
from .crossings import Counts, Integers, Side
from .share import check_counts

Marks = NDArray[np.bool_]

SHAPE = 0.5
"""Exponent a of the law of u."""
GROWTH = 32
"""Of the steps in which a bound is sought."""
PIECE = 2**12
"""Values of a quantile that are looked at together, anew after each rejection."""


def log_wealth_above(p: float, failures: float, count: int) -> float:
    """Return ln W of the bets against P >= p, the first formula at the head of this module; 0 < p < 1.

    >>> round(log_wealth_above(0.01, 0, 299), 3)
    2.321

    """
    a, b = failures + SHAPE, count - failures + 1.0
    return _log_scaled(p, a, b, float(scipy.special.betainc(a, b, p)))


def log_wealth_below(p: float, failures: float, count: int) -> float:
    """Return ln W of the bets against P <= p, the second formula at the head of this module; 0 < p < 1.

    Without a failure W is below 1, and -inf stands for it.

    >>> round(log_wealth_below(0.001, 10, 1000), 3), log_wealth_below(0.001, 0, 1000)
    (12.032, -inf)

    """
    if not failures:
        return -math.inf
    a, b = failures - SHAPE, count - failures + 1.0
    return _log_scaled(p, a, b, float(scipy.special.betaincc(a, b, p)))


def _log_scaled(p: float, a: float, b: float, tail: float) -> float:
    """Return ln of SHAPE p^-a (1 - p)^(1 - b) B(a, b) tail; -inf for a tail that is 0 in doubles, which is safe."""
    if not tail:
        return -math.inf
    beta = math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    return math.log(SHAPE) + math.log(tail) + beta - a * math.log(p) - (b - 1.0) * math.log1p(-p)


def beta_mixture_upper(failures: int, count: int, delta: float) -> float:
    """Return an upper bound of the probability of a failure, with probability 1 - delta for all n at once.
    Implements eq. (failure probability) of [PB].

    Formula: the least multiple p of 1e-9 whose W, against P >= p, is at least 1/delta; 1 without one. W rises in p, so
    that every larger one is rejected too. A ROUND_OFF above 1/delta decides, so that no error of the special functions
    does. Assumes independent samples that fail with one probability, each entered whatever its outcome; n may depend on
    the outcomes up to the n-th.

    Raises:
        ValueError: `failures` is outside [0, count], there is no sample, or delta is outside (0, 1).

    >>> beta_mixture_upper(0, 299, 0.05), beta_mixture_upper(3, 1000, 0.05), beta_mixture_upper(3, 3, 0.05)
    (0.012583298, 0.01078613, 1.0)

    """
    check_counts(failures, count, delta)
    return _least_rejected(failures, count, delta, STEP) / STEP


def beta_mixture_lower(failures: int, count: int, delta: float) -> float:
    """Return a lower bound of the probability of a failure, with probability 1 - delta for all n at once.
    Implements eq. (failure probability) of [PB].

    Formula: the largest multiple p of 1e-9 whose W, against P <= p, is at least 1/delta; 0 without one. Assumptions as
    of `beta_mixture_upper`; both bounds together fail with the sum of their deltas.

    Raises:
        ValueError: `failures` is outside [0, count], there is no sample, or delta is outside (0, 1).

    >>> beta_mixture_lower(0, 299, 0.05), beta_mixture_lower(10, 1000, 0.05), beta_mixture_lower(3, 3, 0.05)
    (0.0, 0.003285205, 0.157853513)

    """
    check_counts(failures, count, delta)
    return _largest_rejected(failures, count, delta, 0) / STEP


class FailureSequence:
    """Bounds of the probability of a failure after every sample, valid for all n at once; running extremes.
    Implements eq. (failure probability) of [PB].

    Formula: the least `beta_mixture_upper` and the largest `beta_mixture_lower` so far, each with its own 1 - delta.
    Assumptions as there. Of a sequence for one bound `only`, the other one follows from the last n alone.

    Raises:
        ValueError: delta is outside (0, 1).

    >>> bounds = FailureSequence(delta=0.05)
    >>> for j in range(1000):
    ...     bounds.add(j % 100 == 99)
    >>> bounds.count, bounds.failures, bounds.lower(), bounds.upper()
    (1000, 10, 0.003285205, 0.020762388)

    """

    def __init__(self, *, delta: float, only: Literal["upper", "lower"] | None = None) -> None:
        check_counts(0, 1, delta)
        self._delta, self._only = delta, only
        self.count = self.failures = 0
        self._last = False
        self._above, self._below = STEP, 0  # P >= above/STEP and P <= below/STEP are rejected

    def upper(self) -> float:
        """Return the upper bound, rounded up to 1e-9; 1 while nothing is rejected."""
        return self._lowered(self.failures, self.count, self._above) / STEP

    def lower(self) -> float:
        """Return the lower bound, rounded down to 1e-9; 0 while nothing is rejected."""
        return self._raised(self.failures, self.count, self._below) / STEP

    def add(self, failed: bool) -> None:
        """Add the next sample."""
        # Successes raise W against P >= p alone, and failures W against P <= p: only the last of a series counts.
        if failed and not self._last and self._only != "lower":
            self._above = self._lowered(self.failures, self.count, self._above)
        elif self._last and not failed and self._only != "upper":
            self._below = self._raised(self.failures, self.count, self._below)
        self._last = failed
        self.count += 1
        self.failures += failed

    def add_each(self, failed: Marks) -> None:
        """Add the next samples (k,) in their order."""
        if len(failed) == 1:
            self.add(bool(failed[0]))  # in a tenth of the time
            return
        # As in `add` the bounds change where a series ends; series of failures and of successes take turns.
        ends, last = (failed[1:] != failed[:-1]).nonzero()[0] + 1, int(self._last)
        if bool(failed[0]) != self._last:
            ends = np.concatenate(([0], ends))
        series = ends.copy()
        series[1:] -= ends[:-1]
        series[last::2] = 0  # successes
        before = Counts(self.failures + series.cumsum(), self.count + ends)
        threshold = _threshold(self._delta)
        if self._only != "lower":
            self._above = _ABOVE.best(self._above, before[last::2], threshold, self._lowered)
        if self._only != "upper":
            self._below = _BELOW.best(self._below, before[1 - last :: 2], threshold, self._raised)
        self._last = bool(failed[-1])
        self.count += len(failed)
        self.failures += int(np.count_nonzero(failed))

    def _lowered(self, failures: int, count: int, most: int) -> int:
        return _least_rejected(failures, count, self._delta, most)

    def _raised(self, failures: int, count: int, least: int) -> int:
        return _largest_rejected(failures, count, self._delta, least)


class QuantileSequence:
    """Lower bound of the quantile Q_q on a grid, valid for all n at once; values need no range.
    Implements eq. (anytime quantile) of [PB].

    Formula: the largest t_g such that all of t_1 .. t_g are rejected, t_i as soon as W against P(v < t_i) >= q is at
    least 1/delta, with v < t_i as the failure. If t_g > Q_q, then the least t_i above Q_q is rejected. It is one
    candidate, known before the data, and P(v < t_i) >= P(v <= Q_q) >= q: probability <= delta. Assumes independent
    values of one law, and a grid fixed beforehand; n may depend on outcomes.

    Raises:
        ValueError: the grid is empty, infinite or does not rise, or `share` or `delta` is outside (0, 1).

    >>> bound = QuantileSequence(0.1, [g / 100 for g in range(-100, 101)], delta=0.05)
    >>> for j in range(1600):
    ...     bound.add((j * 37 % 100 + 0.5) / 100)  # the tenth worst of a hundred is .095
    >>> bound.count, bound.lower()
    (1600, 0.07)

    """

    def __init__(self, share: float, grid: Sequence[float], *, delta: float) -> None:
        check_counts(0, 1, delta)
        if not 0.0 < share < 1.0:
            raise ValueError(f"share must be in (0, 1), not {share!r}")
        if not grid or not all(map(math.isfinite, grid)) or any(a >= b for a, b in pairwise(grid)):
            raise ValueError("the grid must have finite values that rise, at least one")
        self._share, self._grid, self._threshold = share, tuple(grid), _threshold(delta)
        self._limits = np.array(grid)
        self._cells = np.zeros(len(grid) + 1, dtype=np.int64)  # values from t_i on and below t_(i+1)
        self.count = self._rejected = self._failures = 0  # failures: values below the least t_i that is not rejected

    def lower(self) -> float | None:
        """Return the bound, a value of the grid; None while nothing is rejected."""
        return self._grid[self._rejected - 1] if self._rejected else None

    def add(self, value: float) -> None:
        """Add the next value.

        Raises:
            ValueError: the value is not a number.

        """
        if math.isnan(value):
            raise ValueError(f"a value must be a number, not {value!r}")
        cell = bisect_right(self._grid, value)
        self._cells[cell] += 1
        self.count += 1
        self._failures += cell <= self._rejected
        self._advance()

    def add_each(self, values: Floats) -> None:
        """Add the next values (k,) in their order.

        Raises:
            ValueError: a value is not a number; nothing changes.

        """
        if np.isnan(values).any():
            raise ValueError(f"a value must be a number, not {values.tolist()!r}")
        cells = np.searchsorted(self._limits, values, side="right")
        for first in range(0, len(cells), PIECE):
            self._add_cells(cells[first : first + PIECE])

    def _add_cells(self, cells: Integers) -> None:
        while len(cells) and self._rejected < len(self._grid):
            k = self._failures + np.cumsum(cells <= self._rejected)
            n = self.count + np.arange(1, len(cells) + 1)
            place = _ABOVE.first(self._share, Counts(k, n), self._threshold)
            if place is None:
                break
            self._enter(cells[: place + 1])
            self._advance()
            cells = cells[place + 1 :]
        self._enter(cells)

    def _enter(self, cells: Integers) -> None:
        self._cells += np.bincount(cells, minlength=len(self._cells))
        self.count += len(cells)
        self._failures += int(np.count_nonzero(cells <= self._rejected))

    def _advance(self) -> None:
        # More values are below t_i the larger i is: the least one that is left is rejected first.
        while self._rejected < len(self._grid) and self._rejects():
            self._rejected += 1
            self._failures += int(self._cells[self._rejected])

    def _rejects(self) -> bool:
        return log_wealth_above(self._share, self._failures, self.count) >= self._threshold


_ABOVE, _BELOW = Side(log_wealth_above, falls=True), Side(log_wealth_below, falls=False)


def _threshold(delta: float) -> float:
    """Return ln W from which a candidate is rejected; ROUND_OFF is far above the errors of lgamma for n up to 10^9."""
    return math.log((1.0 + ROUND_OFF) / delta)


def _least_rejected(failures: int, count: int, delta: float, most: int) -> int:
    """Return the least g below `most` such that P >= g/STEP is rejected; `most` without one."""
    threshold = _threshold(delta)
    return most - _passed(lambda g: log_wealth_above((most - g) / STEP, failures, count) - threshold, most - 1)


def _largest_rejected(failures: int, count: int, delta: float, least: int) -> int:
    """Return the largest g above `least` such that P <= g/STEP is rejected; `least` without one."""
    threshold = _threshold(delta)
    return least + _passed(
        lambda g: log_wealth_below((least + g) / STEP, failures, count) - threshold, STEP - 1 - least
    )


def _passed(excess: Callable[[int], float], room: int) -> int:
    """Return the largest g in 1 .. `room` whose excess is not negative, where it falls; 0 without one."""
    low, high, step = 0, room + 1, 1
    above = below = -math.inf  # excess at low and at high
    # In steps that grow: from sample to sample the bound moves little.
    while step < high:
        if (found := excess(step)) < 0.0:
            high, below = step, found
        else:
            low, above, step = step, found, GROWTH * step
    side = 0
    while high - low > 1 and low:
        # Regula falsi; an end that stays counts half [Illinois], and one without a finite excess asks for the middle.
        share = above / (above - below) if math.isfinite(below) else 0.5
        middle = min(max(low + round(share * (high - low)), low + 1), high - 1)
        if (found := excess(middle)) < 0.0:
            above = above / 2.0 if side < 0 else above
            high, below, side = middle, found, -1
        else:
            below = below / 2.0 if side > 0 else below
            low, above, side = middle, found, 1
    return low
