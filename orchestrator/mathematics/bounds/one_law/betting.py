"""Lower confidence sequences by betting for the mean of values in [0, 1], on a grid of candidate means.

| symbol     | name          | meaning                                                              | shape  | unit |
|------------|---------------|----------------------------------------------------------------------|--------|------|
| x_i        | `x`           | the i-th value, in [0, 1]; its mean given the past is mu             | ()     | -    |
| G          | `GRID`        | candidates are g/G, g = 0 .. G; a power of two, so g/G is exact      | ()     | -    |
| m          | `_candidate_means` | candidate means, the null hypothesis being mu <= m              | (G+1,) | -    |
| lambda_ji  |               | bet of strategy j on x_i at m, from x_1 .. x_(i-1) alone             | (G+1,) | -    |
| c_j        | `cap`         | share of the wealth that strategy j may lose at once, in (0, 1)      | ()     | -    |
| w_j        | `share`       | share of the first wealth that strategy j is given; they sum to 1    | ()     | -    |
| W_n(m)     |               | wealth, sum_j w_j prod_(i<=n) (1 + lambda_ji (x_i - m))              | (G+1,) | -    |
| delta      |               | failure probability                                                  | ()     | -    |

Validity. Let mu <= m, and 0 <= lambda_ji <= c_j/m with lambda_ji a function of the past. Every factor is at least
1 - c_j > 0 and its mean given the past is 1 + lambda_ji (mu - m) <= 1. So W_n(m) is a positive supermartingale that
starts at 1, and by Ville P[some n: W_n(m) >= 1/delta] <= delta. A candidate is rejected from the first such n on.
Report L = g/G with the largest g such that *all* of 1 .. g are rejected. If ever L > mu, then the smallest multiple of
1/G that is not below mu is rejected, because it is among 1 .. g. It is one candidate, known before the data, with
mu <= m: probability <= delta. Hence mu >= L for all n at once, whatever the bets do from candidate to candidate: no
monotony of W in m is needed, no union over the grid, no n fixed beforehand, and rounding is always to the safe side.
Values may come in batches, with delays, in numbers that depend on outcomes (Ville holds at every stopping time); only
x_i must have its mean given everything that entered before it. An upper bound is 1 - the lower bound of 1 - x.

With a control x_i is less g_i, whose mean given the past is 0: it is in [-max g_i, 1 - min g_i], and a bet is at most
c_j/(m + max g_i).
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ...gp.kernels import Floats
from ..rounding import ROUND_OFF
from .many import are_within
from .wealth import GRID, Moments, Strategy, Wealth

BOLD_AND_CAREFUL = (Strategy(0.7, 0.95, 1.0), Strategy(0.3, 0.5))
"""For some hundred values far from 0 the largest bets are best, so most of the wealth bets boldly. Where values at 0
(a fall) are not rare that is ruinous, and the careful part continues at the price of a factor .3 in W."""

CAREFUL = (Strategy(1.0, 0.5),)


class Past:
    """Count, mean and variance of the values so far; `imaginary` values at 1 count in bets, not in `count`.

    Raises:
        ValueError: `imaginary` is negative.

    """

    __slots__ = ("_squares", "_total", "_weight", "count")

    def __init__(self, imaginary: int = 0) -> None:
        if imaginary < 0:
            raise ValueError(f"imaginary must not be negative, not {imaginary}")
        self.count = 0
        self._weight = self._total = self._squares = float(imaginary)

    def add(self, x: float) -> None:
        """Add a value in [0, 1]."""
        self.count += 1
        self._weight += 1.0
        self._total += x
        self._squares += x * x

    def before(self, values: Sequence[float]) -> Moments:
        """Add values in [0, 1], and return the moments before each of them."""
        found = []
        for x in values:
            found.append(self._moments())
            self.add(x)
        return np.array(found)

    @property
    def mean(self) -> float:
        """Mean, imaginary values included; 0 if there is none, so that nothing is bet."""
        return self._total / self._weight if self._weight else 0.0

    @property
    def now(self) -> Moments:
        """The moments of all values, for one further value."""
        return np.array([self._moments()])

    def _moments(self) -> tuple[float, float, float]:
        """Return mean, mean square deviation from it, and the estimated standard deviation of the mean."""
        if not self._weight:
            return 0.0, 0.0, 0.0
        mean = self._total / self._weight
        variance = max(self._squares / self._weight - mean**2, 0.0)
        return mean, variance, math.sqrt(variance / self._weight)


class BettingSequence:
    """Lower confidence sequence of a mean, running maximum, for one or several failure probabilities at once.
    Implements eq. (capital process) of [WSR].

    Formula: L_n = max{g/G : for all h <= g, max_(i<=n) W_i(h/G) >= 1/delta}, W as at the head of this module.
    One wealth serves every delta in `deltas`; each bound has its own 1 - delta. Work per value is O(G), and only on
    candidates that are neither rejected nor above what any strategy bets on.
    Assumes values in [0, 1] with mean mu given the past. `x` and the result have no unit.
    Deviation: [WSR] bets on both sides and reports a set; here one side, and a share w_j for each strategy.

    Raises:
        ValueError: no delta or one outside (0, 1), no strategy, or shares that do not sum to 1.

    >>> sequence, past = BettingSequence((0.05,)), Past(imaginary=1)
    >>> for _ in range(100):
    ...     sequence.observe(0.75, past)
    ...     past.add(0.75)
    >>> sequence.lower()
    0.724609375

    """

    def __init__(self, deltas: Sequence[float], strategies: Sequence[Strategy] = BOLD_AND_CAREFUL) -> None:
        if not deltas or not all(0.0 < delta < 1.0 for delta in deltas):
            raise ValueError(f"every delta must be in (0, 1), at least one is needed; not {list(deltas)}")
        if not math.isclose(math.fsum(strategy.share for strategy in strategies), 1.0, abs_tol=1e-12):
            raise ValueError("the shares of the strategies must sum to 1")
        thresholds = [(1.0 + ROUND_OFF) / delta for delta in deltas]
        self._bets = Wealth(_candidate_means(), strategies, thresholds)
        self.reach(0.0, 1.0)

    def reach(self, least: float, most: float) -> None:
        """Set what the next values are at least and at most, as a function of those before; their mean is in [0, 1]."""
        self._ends = least, most
        self._bets.limit(_candidate_means() - least)

    def rejected(self, level: int = 0) -> int:
        """Return the largest g such that candidates 1 .. g are rejected at `deltas[level]`."""
        return self._bets.rejected[level]

    def lower(self, level: int = 0) -> float:
        """Return the lower bound of the mean at `deltas[level]`, a multiple of 1/G."""
        return self._bets.rejected[level] / GRID

    def wealth(self) -> Floats:
        """Return W at the candidates g/G, g = 0 .. G-1; those rejected at every level are no longer updated."""
        return np.asarray(np.add.reduce(self._bets.wealth, axis=0))

    def observe(self, x: float, past: Past) -> None:
        """Add a value; `past` contains the values before it and not itself.

        Raises:
            ValueError: `x` is outside [0, 1].

        """
        if not 0.0 <= x <= 1.0:
            raise ValueError(f"a value must be in [0, 1], not {x!r}")
        self._bets.play(np.array([x]), past.now)

    def observe_each(self, x: Floats, past: Moments) -> None:
        """Add values (k,) in their order; `past` has the moments of those before each of them.

        Raises:
            ValueError: a value is outside [0, 1], or what `reach` has set; nothing changes.

        """
        if not are_within(x, *self._ends):
            raise ValueError(f"a value must be in {list(self._ends)}, not {x.tolist()!r}")
        self._bets.play(x, past)


@lru_cache(maxsize=1)
def _candidate_means() -> Floats:
    return np.arange(GRID) / GRID  # (G,)
