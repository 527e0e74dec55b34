"""Wealth of bets against candidate means, on many values at once.

| symbol | name         | meaning                                                                  | shape     | unit |
|--------|--------------|--------------------------------------------------------------------------|-----------|------|
| x_i    | `x`          | the i-th value                                                           | (k,)      | v    |
| m      | `candidates` | G candidates, which rise; the null hypothesis is E[x_i given the past] <= m | (G,)   | v    |
| a_ij   | `aims`       | the mean that strategy j aims at, from x_1 .. x_(i-1) alone              | (k, S)    | v    |
| s_i^2  | `variances`  | the variance that x_1 .. x_(i-1) suggest                                 | (k,)      | v^2  |
| c_j    | `cap`        | share of the wealth that strategy j may lose at once                     | (S,)      | -    |
| r      | `room`       | what a bet of 1 loses at most, at each candidate                         | (G,)      | v    |
| e      | `edges`      | max(a_ij - m, 0)                                                         | (k, S, G) | v    |
| lambda |              | bet min(e/(s_i^2 + e^2), c_j/r); 0 for e = 0                             | (k, S, G) | 1/v  |
| W_j    | `wealth`     | share of strategy j times prod_i (1 + lambda (x_i - m))                  | (S, G)    | -    |
| W      |              | sum_j W_j                                                                | (G,)      | -    |
| max W  | `peak`       | running maximum                                                          | (G,)      | -    |

No bet depends on a wealth. So the bets on k values are known together, and what is left is a product in the order of
the values: all numbers are to the bit those of one value after the other. Only candidates above the rejected ones and
below a mean aimed at are bet on, which are few of G after some thousand values.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...gp.kernels import Floats
from ..rounding import RICHEST

GRID = 4096
MOST_BETS = 2**14
"""Bets that are computed together: what is computed of them stays in the cache of a CPU."""
MOST_VALUES = 256
"""Values that are bet on together, so that hardly any product has to be cut at RICHEST."""
NARROW = 128
"""Numbers of wealth up to which `accumulate`, at 4 ns a number, takes less time than a call for each value."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """A rule of betting: Kelly's bet to second order, for the mean that the past suggests.

    `share` of the first wealth, `cap` on what may be lost at once, and `optimism`: the mean is taken that many standard
    errors above the past one, so that a short unlucky past does not end the betting.

    Raises:
        ValueError: share is outside (0, 1], cap outside (0, 1), or optimism negative.

    """

    share: float
    cap: float
    optimism: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.share <= 1 and 0 < self.cap < 1 and 0 <= self.optimism < math.inf):
            raise ValueError(f"a strategy needs share in (0, 1], cap in (0, 1), optimism >= 0; not {self}")


Moments = Floats
"""Mean, variance and standard error of the mean that the values before each of k values suggest, (k, 3)."""


class Wealth:
    """The wealth of several strategies at all candidates, and the candidates that it rejects at each threshold.

    Candidate g is rejected as soon as max W has reached the threshold at all of 1 .. g; what is rejected at every
    threshold keeps its wealth. Candidate 0 is never bet on.
    """

    def __init__(self, candidates: Floats, strategies: Sequence[Strategy], thresholds: Sequence[float]) -> None:
        self.candidates, self.thresholds = candidates, tuple(thresholds)
        self._optimism = np.array([each.optimism for each in strategies])
        self._caps = np.array([[each.cap] for each in strategies])  # (S, 1)
        self.wealth = np.repeat([[each.share] for each in strategies], len(candidates), axis=1)
        self.peak = np.ones(len(candidates))
        self.rejected = [0] * len(self.thresholds)
        """The largest g such that candidates 1 .. g are rejected, for each threshold."""
        self._most = np.zeros_like(self.wealth)

    def limit(self, room: Floats) -> None:
        """Set `room` (G,) of the next values, a function of those before."""
        np.divide(self._caps, room[1:], out=self._most[:, 1:])

    def play(self, x: Floats, past: Moments) -> None:
        """Bet on x (k,) in the order of the values; `past` has the moments of those before each of them."""
        aims, variances = past[:, :1] + self._optimism * past[:, 2:], past[:, 1]
        start, end = self._live(aims)
        if end > start and len(x) > 1:
            # A bet of 0 at every candidate that is left changes nothing.
            useful = aims.max(axis=1) > self.candidates[start]
            x, aims, variances = x[useful], aims[useful], variances[useful]
        while end > start:
            k = max(min(MOST_BETS // (len(self._caps) * (end - start)), MOST_VALUES), 1)
            self._grow(slice(start, end), x[:k], aims[:k], variances[:k])
            if k >= len(x):
                return
            x, aims, variances = x[k:], aims[k:], variances[k:]
            start, end = self._live(aims)

    def _live(self, aims: Floats) -> tuple[int, int]:
        """Return the candidates that are bet on."""
        # A candidate that is rejected at every threshold remains so: no wealth is needed there.
        return 1 + min(self.rejected), int(self.candidates.searchsorted(_largest(aims)))

    def _grow(self, live: slice, x: Floats, aims: Floats, variances: Floats) -> None:
        m, peak, before = self.candidates[live], self.peak[live], min(self.rejected)
        edges = aims[:, :, None] - m  # (k, S, A), as all that follow
        np.maximum(edges, 0.0, out=edges)
        spreads = edges * edges
        spreads += variances[:, None, None]
        if np.count_nonzero(variances) < len(variances):
            spreads[spreads == 0.0] = np.inf
        np.divide(edges, spreads, out=edges)
        # The cap keeps every factor of the wealth at least 1 - cap > 0, even for the least x.
        np.minimum(edges, self._most[:, live], out=edges)
        edges *= (x[:, None] - m)[:, None]
        edges += 1.0
        history = _products(edges, self.wealth[:, live])
        self.wealth[:, live] = history[-1]
        totals = history[:, 0]  # (k, A)
        for j in range(1, len(self._caps)):
            totals = totals + history[:, j]
        old = peak.copy()
        np.maximum(peak, totals[0] if len(x) == 1 else totals.max(axis=0), out=peak)
        self._settle()
        rejected = min(min(self.rejected) - before, live.stop - live.start)
        if rejected and len(x) > 1:
            self._stop(slice(live.start, live.start + rejected), history, totals, old)

    def _settle(self) -> None:
        """Count on from the last rejected candidate to the first that is not, at every threshold."""
        for level, threshold in enumerate(self.thresholds):
            g = self.rejected[level] + 1
            if g < len(self.peak) and self.peak[g] >= threshold:
                accepted = self.peak[g:] < threshold
                self.rejected[level] += int(accepted.argmax()) if accepted.any() else len(accepted)

    def _stop(self, rejected: slice, history: Floats, totals: Floats, peak: Floats) -> None:
        """Give candidates the wealth with which they were rejected: what was bet on them afterwards counts nowhere."""
        columns = np.arange(rejected.stop - rejected.start)
        peaks = np.maximum.accumulate(np.vstack([peak[columns], totals[:, columns]]), axis=0)  # (k + 1, columns)
        # Rejected when all up to it are, and 0 stands for before.
        steps = np.maximum.accumulate((peaks >= max(self.thresholds)).argmax(axis=0))
        self.peak[rejected] = peaks[steps, columns]
        self.wealth[:, rejected] = history[steps - 1, :, columns].T


def _products(factors: Floats, wealth: Floats) -> Floats:
    """Return the wealth after each value, in the place of the factors (k, S, A)."""
    if len(factors) > 1 and wealth.size <= NARROW and _is_small(factors, wealth):
        factors[0] *= wealth
        return np.multiply.accumulate(factors, axis=0, out=factors)
    for row in factors:
        np.multiply(wealth, row, out=row)
        wealth = np.minimum(row, RICHEST, out=row)
    return factors


def _is_small(factors: Floats, wealth: Floats) -> bool:
    """Whether no product is cut at RICHEST."""
    largest = len(factors) * math.log(max(_largest(factors), 1.0)) + math.log(_largest(wealth))
    return largest < math.log(RICHEST) - 1.0


def _largest(values: Floats) -> float:
    # For few values a third of the time of `max`.
    return float(values.item(values.argmax()))
