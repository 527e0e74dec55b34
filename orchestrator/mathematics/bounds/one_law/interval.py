"""A mean between bounds from both sides, valid for all n at once.

| symbol | name         | meaning                                                              | shape  | unit |
|--------|--------------|----------------------------------------------------------------------|--------|------|
| v_i    | `values`     | the i-th value, in [low, high]; its mean given the past is mu        | (n,)   | v    |
| a      | `about`      | in [low, high]; candidates are closest there                         | ()     | v    |
| m      | `candidates` | a + (high - a) u^3 for u >= 0, a - (a - low) |u|^3 for u < 0; u = g/(G/2) - 1 | (G,) | v  |
| delta  | `delta`      | failure probability of the interval, half of it for each side        | ()     | -    |

The lower bound is that of `betting`, whose proof needs of the candidates only that they were known beforehand. Those
here have a distance near a that no number of values makes too coarse: a difference of rare failures is far smaller than
its range, and candidates at equal distances would round it away. The upper bound is the negative of that of -v.
"""

import math

import numpy as np

from ...gp.kernels import Floats
from ..rounding import ROUND_OFF, round_down, round_up
from .betting import BOLD_AND_CAREFUL
from .many import are_within, squares
from .risk import check_clip
from .wealth import GRID, Moments, Wealth


def mean_interval(values: Floats, ends: tuple[float, float], delta: float, *, about: float) -> tuple[float, float]:
    """Return lower and upper bound of mu from values (n,) in their order, outward to 1e-9; the ends without a value.
    Implements eq. (capital process) of [WSR], on both sides.

    What it returns for the first values contains what it returns for all: with probability 1 - delta all of them
    contain mu at once, so that a look after each value, and a stop that depends on them, are allowed. Assumes values in
    [low, high] whose mean given the past is mu, as those of one law are. The unit is that of the values.

    Raises:
        ValueError: the range is empty or infinite, `about` or a value is outside it, or delta is outside (0, 1).

    >>> shaken = 0.02 + 0.1 * np.sin(np.arange(2000.0) ** 2)
    >>> [round(bound, 4) for bound in mean_interval(shaken, (-1.6, 1.6), 0.05, about=0.0)]
    [0.015, 0.0246]

    """
    low, high = check_clip(ends)
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must be in (0, 1), not {delta!r}")
    if not low <= about <= high:
        raise ValueError(f"about must be in [{low}, {high}], not {about!r}")
    if len(values) and not are_within(values, low, high):
        raise ValueError(f"a value must be in [{low}, {high}]")
    # A candidate as computed may be a rounding error beyond its definition.
    error = 1e-12 * (high - low)
    lower = round_down(_lower(values, low, high, delta / 2, about) - error)
    upper = round_up(-_lower(-values, -high, -low, delta / 2, -about) + error)
    return max(lower, low), min(upper, high)


def _lower(values: Floats, low: float, high: float, delta: float, about: float) -> float:
    u = np.arange(GRID) / (GRID // 2) - 1.0
    candidates = about + np.where(u < 0.0, about - low, high - about) * u**3  # (G,)
    bets = Wealth(candidates, BOLD_AND_CAREFUL, [(1.0 + ROUND_OFF) / delta])
    bets.limit(np.maximum(candidates - low, 1e-9 * (high - low)))
    if len(values):
        bets.play(values, _before(values, about))
    return float(candidates[bets.rejected[0]])


def _before(values: Floats, about: float) -> Moments:
    """Return the moments of the values before each of them; before the first one nothing is aimed at."""
    shifted = values - about
    n = np.arange(1, len(values))
    means, second = np.cumsum(shifted)[:-1] / n, np.cumsum(squares(shifted))[:-1] / n
    variances = np.maximum(second - squares(means), 0.0)
    later = np.column_stack([about + means, variances, np.sqrt(variances / n)])
    return np.vstack([[-math.inf, 0.0, 0.0], later])
