"""Bounds for shares of a distribution of starts, from starts that are drawn independently from it.

| symbol   | name       | meaning                                                              | shape  | unit |
|----------|------------|----------------------------------------------------------------------|--------|------|
| n, k     | `count`, `failures` | independent trials, fixed beforehand, and failures among them | ()   | -    |
| v_j      | `value`    | mean of the rollouts of the j-th start, in [low, high]; large is good | ()    | v    |
| q        | `share`    | share of the starts that may be worse, in (0, 1)                     | ()     | -    |
| t_j      | `_bar`     | in [low, high], from v_1 .. v_(j-1) alone                            | ()     | v    |
| x_j      |            | t_j - max(t_j - v_j, 0)/q, in [t_j - (t_j - low)/q, t_j]             | ()     | v    |
| CVaR_q   |            | mean of v over its worst share q: max over t of t - E[max(t - v, 0)]/q | ()   | v    |
| m        | `_candidates` | candidates low + (high - low) g/G; the null hypothesis is CVaR_q <= m | (G,) | v   |
| lambda_j |            | bet on x_j at m, at most cap/(m - least x_j)                         | (G,)   | 1/v  |
| delta    | `delta`    | failure probability of a bound                                       | ()     | -    |

Given the past, x_j has a mean of at most CVaR_q, whatever t_j is. So the wealth of `betting` is a supermartingale for
every m >= CVaR_q if each bet is capped by the range of *this* x_j. As there, the bound is the largest candidate up to
which all are rejected, and it is valid for all n at once.

All but a share q of the starts have E[v | d] >= CVaR_q. If A = {d : E[v | d] < CVaR_q} had P(A) >= q, then the worst
share q of v would have a mean of at most E[v | A] < CVaR_q, a contradiction. No kernel and no smoothness are needed.
"""

import math
from bisect import insort
from collections.abc import Sequence

import numpy as np
from scipy.special import bdtr, betaincinv

from ..gp.kernels import Floats
from .betting import GRID, RICHEST, ROUND_OFF, Strategy
from .risk import check_clip
from .rounding import round_down, round_up

STRATEGIES = (Strategy(0.9, 0.95, 1.0), Strategy(0.1, 0.5))
"""The largest bets are nearly always best here: the least x, which caps them, is far below the others."""
RENEWAL = 1.05
"""t_j, and the moments of x at t_j, are computed anew when there are this many times as many values."""


def clopper_pearson_upper(failures: int, count: int, delta: float) -> float:
    """Return an upper bound of the probability of a failure, with probability 1 - delta, rounded up to 1e-9.
    Implements eq. (Clopper-Pearson) of [PB].

    Formula: the largest p with P[Bin(n, p) <= k] >= delta; 1 for k = n. Assumes n independent trials, n fixed
    beforehand, and that a missing trial is counted as a failure.

    Raises:
        ValueError: `failures` is outside [0, count], there is no trial, or delta is outside (0, 1).

    >>> clopper_pearson_upper(0, 299, 0.05), clopper_pearson_upper(3, 3, 0.05)
    (0.009969147, 1.0)

    """
    if not 0 <= failures <= count or count < 1:
        raise ValueError(f"failures must be in [0, {count}] and count at least 1, not {failures}")
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must be in (0, 1), not {delta!r}")
    if failures == count:
        return 1.0
    p = round_up(min(float(betaincinv(failures + 1, count - failures, 1.0 - delta)), 1.0))
    # The quantile function is iterative: the distribution function, with its own round-off, decides.
    while p < 1.0 and not float(bdtr(failures, count, p)) <= delta * (1.0 - 1e-12):
        p = min(round_up(p + 1e-9), 1.0)
    return p


def unseen_share(count: int, delta: float) -> float:
    """Return the share of failures that `count` random trials without a failure miss with probability delta.

    Formula: p with (1 - p)^n = delta, the bound of Clopper and Pearson for k = 0, not rounded.

    >>> round(unseen_share(20, 0.05), 3)
    0.139

    """
    return float(1.0 - delta ** (1.0 / count))


def quantile_rank(count: int, share: float, delta: float) -> int | None:
    """Return the k for which the k-th smallest of `count` values is a lower bound of their quantile; None without one.
    Implements eq. (quantile) of [PB].

    Formula: the largest k with P[Bin(n, q) <= k - 1] <= delta. Then P[v_(k) <= Q_q] >= 1 - delta for every law, Q_q =
    inf{t: P(v <= t) >= q}. Assumes n independent values, n fixed beforehand.

    Raises:
        ValueError: there is no value, or `share` or `delta` is outside (0, 1).

    >>> quantile_rank(29, 0.1, 0.05), quantile_rank(28, 0.1, 0.05), quantile_rank(1600, 0.1, 0.05)
    (1, None, 140)

    """
    if count < 1 or not 0.0 < share < 1.0 or not 0.0 < delta < 1.0:
        raise ValueError(f"count must be positive, share and delta in (0, 1); not {count!r}, {share!r}, {delta!r}")
    below = np.asarray(bdtr(np.arange(count), count, share)) <= delta * (1.0 - 1e-12)
    return int(below.sum()) or None


class AllButShare:
    """Lower bound of E[v | d] for all starts but a share q, valid for all n at once; the running maximum.
    Implements eq. (all but a share) of [PB].

    Formula: the betting lower bound of CVaR_q from x_j as at the head of this module, rounded down to 1e-9; t_j is the
    sample quantile of the values before. Assumes independent starts from one distribution, each with its mean v_j over
    the same number of rollouts; a claim for the risk takes the linearised risk as the value of a rollout.

    Raises:
        ValueError: the range is empty or infinite, or `share` or `delta` is outside (0, 1).

    >>> bound = AllButShare(0.1, (0.0, 1.0), delta=0.05)
    >>> for j in range(400):
    ...     bound.add(0.6 + 0.001 * (j * 37 % 100))  # the worst tenth has the mean .6045
    >>> bound.count, round(bound.lower(), 3)
    (400, 0.555)

    """

    def __init__(
        self, share: float, clip: tuple[float, float], *, delta: float, strategies: Sequence[Strategy] = STRATEGIES
    ) -> None:
        if not 0.0 < share < 1.0 or not 0.0 < delta < 1.0:
            raise ValueError(f"share and delta must be in (0, 1), not {share!r} and {delta!r}")
        self._low, self._high = check_clip(clip)
        self._share, self._threshold, self._strategies = share, (1.0 + ROUND_OFF) / delta, tuple(strategies)
        self._candidates = self._low + (self._high - self._low) * (np.arange(GRID) / GRID)  # (G,)
        self._wealth = np.repeat([[each.share] for each in strategies], GRID, axis=1)  # (S, G)
        self._peak = np.ones(GRID)  # (G,)
        self._rejected = 0
        self._sorted: list[float] = []
        self._bar, self._renewal = self._low, 1.0
        self._weight = self._mean = self._squares = 0.0  # moments of x at the current t_j

    @property
    def count(self) -> int:
        """Number of values n."""
        return len(self._sorted)

    def lower(self) -> float:
        """Return the bound, in the unit of v; `low` while nothing is rejected."""
        if not self._rejected:
            return self._low
        # The candidate as computed may be a rounding error above its definition.
        return max(round_down(float(self._candidates[self._rejected]) - 1e-12 * (self._high - self._low)), self._low)

    def add(self, value: float) -> None:
        """Add the mean of the next start.

        Raises:
            ValueError: the value is outside the range.

        """
        if not self._low <= value <= self._high:
            raise ValueError(f"a value must be in [{self._low}, {self._high}], not {value!r}")
        x = self._shortfall(value)
        self._bet(x)
        insort(self._sorted, value)
        if self.count >= self._renewal:
            self._renew()
        else:
            self._take(x)

    def _shortfall(self, value: float) -> float:
        """Return x of a value at the current t."""
        return self._bar - max(self._bar - value, 0.0) / self._share

    def _renew(self) -> None:
        """Move t to the sample quantile, and compute the moments of x at it."""
        self._renewal = RENEWAL * self.count
        worst = max(math.ceil(self._share * self.count) - 1, 0)
        self._bar = self._sorted[worst]
        self._weight = self._mean = self._squares = 0.0
        for value in self._sorted[:worst]:
            self._take(self._shortfall(value))
        # All others have x = t: they enter the moments together.
        above, shift = self.count - worst, self._bar - self._mean
        self._squares += shift * shift * worst * above / self.count
        self._mean += shift * above / self.count
        self._weight = float(self.count)

    def _take(self, x: float) -> None:
        """Add x to the moments [Welford's update]."""
        self._weight += 1.0
        shift = x - self._mean
        self._mean += shift / self._weight
        self._squares += shift * (x - self._mean)

    def _bet(self, x: float) -> None:
        """Move the wealth of the candidates that are not rejected; the bets are functions of the past."""
        start = self._rejected + 1
        m = self._candidates[start:]
        variance = self._squares / self._weight if self._weight else 0.0
        error = math.sqrt(variance / self._weight) if self._weight else 0.0
        # Every factor stays at least 1 - cap > 0, also for the least x that this t allows.
        room = np.maximum(m - (self._bar - (self._bar - self._low) / self._share), 1e-9 * (self._high - self._low))
        for s, strategy in enumerate(self._strategies):
            edge = np.maximum(self._mean + strategy.optimism * error - m, 0.0) if self._weight else np.zeros_like(m)
            bets = _kelly(edge, variance, strategy.cap / room)
            wealth = self._wealth[s, start:]
            np.minimum(wealth * (1.0 + bets * (x - m)), RICHEST, out=wealth)
        peak = self._peak[start:]
        np.maximum(peak, np.add.reduce(self._wealth[:, start:], axis=0), out=peak)
        accepted = peak < self._threshold
        self._rejected += int(accepted.argmax()) if accepted.any() else len(accepted)


def _kelly(edge: Floats, variance: float, largest: Floats) -> Floats:
    """Return the bet that is best to second order for a mean `edge` above the candidate, capped."""
    spread = variance + edge * edge
    return np.minimum(np.divide(edge, spread, out=np.zeros_like(edge), where=spread > 0), largest)
