"""Audit of the norm that method `kriging` assumes: one more martingale, in the direction in which mu looks too rough.

| symbol | name        | meaning                                                           | shape  | unit     |
|--------|-------------|-------------------------------------------------------------------|--------|----------|
| x_i    |             | points of the design                                              | (q,)   | -        |
| K      | `kernel`    | kernel between them                                               | (q, q) | -        |
| n_i    | `planned`   | rollouts planned at x_i                                           | (q,)   | -        |
| s      | `spread`    | guess of the standard deviation of a rollout                      | ()     | unit X   |
| z_i    | `means`     | mean of the rollouts at x_i so far                                | (q,)   | unit X   |
| r_i    | `roughness` | coefficients of (K + diag(s^2/(B^2 n_i)))^-1 (z - m0), n_i so far | (q,)   | unit X   |
| v_t    |             | C r_i/n_i for a rollout at x_i, C and r from the tests before it  | ()     | 1/unit X |
| W_i    | `weights`   | sum of v_t over the rollouts at x_i                               | (q,)   | 1/unit X |
| B_min  | `b_min`     | smallest norm that the rollouts allow                             | ()     | unit X   |

sum_t v_t f(x_t) >= S - m0 V as in `kriging`, at a failure probability of its own, and it is at most B sqrt(W' K W). So
B is at least (S - m0 V)/sqrt(W' K W), for all n at once. With fixed weights, or those of the bound, the test would have
no power: r is what the interpolant of the past means needs of each kernel function.
"""

import math
from collections.abc import Sequence

import numpy as np

from ...gp.kernels import Floats
from .bound import EPSILON, GuessedMean, KrigingPremises

MOST_CUT = 3.0
"""Planned weights are at most so many times what leaves the wealth positive; the rest is cut."""
FEW = 10.0
"""Rollouts at a point that show its variance as well as those of all points do."""
AMPLITUDES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.06, 0.03)
"""Amplitudes of a forecast that are tried, in units of B."""


class PointMeans:
    """Means of the rollouts at the points of a design, and their interpolant (kriging with noise)."""

    def __init__(self, kernel: Floats, premises: KrigingPremises, spread: float) -> None:
        self.kernel, self._premises = kernel, premises
        self._noise = (spread / premises.rkhs_norm) ** 2
        self.counts, self._sums = np.zeros(len(kernel)), np.zeros(len(kernel))
        self._squares = np.zeros(len(kernel))

    def add(self, point: int, values: Sequence[float]) -> None:
        """Add the rollouts of one test."""
        self.counts[point] += len(values)
        self._sums[point] += math.fsum(values)
        # About m0, where fewer digits cancel.
        self._squares[point] += math.fsum((value - self._premises.prior_mean) ** 2 for value in values)

    def variances(self) -> Floats:
        """Return the variance of a rollout at each point, with that of all points as half of the evidence, (q,)."""
        seen = np.maximum(self.counts, 1.0)
        shifts = self._sums / seen - self._premises.prior_mean
        squares = np.maximum(self._squares - seen * shifts**2, 0.0)
        free = np.maximum(self.counts - 1.0, 0.0)
        pooled = float(squares.sum() / max(float(free.sum()), 1.0))
        return np.asarray((squares + FEW * pooled) / (free + FEW), dtype=np.float64)

    def posterior(self, variances: Floats) -> tuple[Floats, Floats]:
        """Return mean (q,) and covariance (q, q) of mu at the points, of a Gaussian process around m0.

        Its amplitude is the likeliest of B and parts of B: one of amplitude B has a norm far above B.
        """
        seen = self.counts > 0
        noise = np.diag(variances[seen] / self.counts[seen])
        shift = self._sums[seen] / self.counts[seen] - self._premises.prior_mean
        inner = self.kernel[np.ix_(seen, seen)]

        def likelihood(amplitude: float) -> float:
            gram = amplitude**2 * inner + noise + 1e-12 * amplitude**2 * np.eye(len(shift))
            return float(-shift @ np.linalg.solve(gram, shift) - np.linalg.slogdet(gram)[1])

        amplitude = max((self._premises.rkhs_norm * part for part in AMPLITUDES), key=likelihood)
        between = amplitude**2 * self.kernel[:, seen]
        gram = between[seen] + noise + 1e-12 * amplitude**2 * np.eye(len(shift))
        solved = np.linalg.solve(gram, np.column_stack([shift, between.T]))
        return self._premises.prior_mean + between @ solved[:, 0], amplitude**2 * self.kernel - between @ solved[:, 1:]

    def roughness(self) -> Floats:
        """Return r, 0 at points without rollouts, (q,)."""
        seen = self.counts > 0
        matrix = self.kernel.copy() if seen.all() else self.kernel[np.ix_(seen, seen)]
        matrix.flat[:: len(matrix) + 1] += self._noise / self.counts[seen]
        found = np.zeros(len(self.counts))
        means = self._sums[seen] / self.counts[seen]
        found[seen] = np.linalg.solve(matrix, means - self._premises.prior_mean)
        return found


class NormAudit:
    """The martingale of the audit; every point is tested once before it bets."""

    def __init__(self, means: PointMeans, planned: Floats, premises: KrigingPremises, spread: float) -> None:
        self._means, self._planned, self._premises = means, planned, premises
        self._variance = spread**2
        self._guess = GuessedMean(premises)
        self._sum, self._count = 0.0, 0
        self._largest = max(*map(abs, premises.ends), abs(premises.prior_mean))
        self._weights = np.zeros(len(planned))
        self._used, self._begun = planned > 0, False
        self.b_min = 0.0

    def observe(self, point: int, values: Sequence[float], ends: tuple[float, float] | None = None) -> None:
        """Bet on the rollouts of one test, before they enter `means`, and raise `b_min`; `ends` as for the bounds."""
        if ends is not None:
            self._guess.ends = ends
            self._largest = max(self._largest, abs(ends[0]), abs(ends[1]))
        planned = self._weight(point)
        for value, (u, low, high) in zip(values, self._guess.before(values), strict=True):
            v = min(max(planned, low), high)
            self._sum += v * u + math.log1p(v * (value - u))
            self._weights[point] += v
        self._count += len(values)
        self.b_min = max(self.b_min, self._norm())

    def plan(self, means: PointMeans, spread: float) -> None:
        """Take other means and another guess of the noise for the bets from now on; both may depend on the past."""
        self._means, self._variance = means, spread**2

    def _weight(self, point: int) -> float:
        """Return v of the next rollout, a function of the tests before it."""
        if not self._planned[point]:
            return 0.0
        if not self._begun:
            self._begun = bool(np.all(self._means.counts[self._used] > 0))
            if not self._begun:
                return 0.0
        r = self._means.roughness()
        each = r[self._used] / self._planned[self._used]
        # What a full campaign with these r would lose to ln(1/delta) and to the variance is least for this C.
        variance = 0.5 * self._variance * float(np.sum(r[self._used] * each))
        if not variance:
            return 0.0
        low, high = self._guess.limits
        # With little noise it is so large that every weight would be cut, which leaves of r no more than its signs.
        largest = MOST_CUT / float(np.max(np.maximum(each / low, each / high)))
        return min(math.sqrt(self._premises.cost / variance), largest) * float(r[point] / self._planned[point])

    def _norm(self) -> float:
        """Return the norm that the rollouts so far need at 1 - delta.
        Implements eq. (kriging norm) of [PB].

        Formula: (S - m0 sum_t v_t)/sqrt(W' K W), 0 if negative; rounded down.
        """
        w = self._weights
        moved = float(np.abs(w).sum())
        excess = self._sum - self._premises.cost - self._premises.prior_mean * float(w.sum())
        excess -= EPSILON * (self._count + 100) * (1.0 + 12.0 * self._largest * moved)  # as in `kriging`
        squared = float(w @ self._means.kernel @ w) + EPSILON * 1e3 * moved**2
        return max(0.0, excess / math.sqrt(squared)) if squared > 0 else 0.0
