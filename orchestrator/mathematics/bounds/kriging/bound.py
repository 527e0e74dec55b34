"""Lower bounds of a mean over every cell of a box, from weighted sums of bounded rollouts.

| symbol | name          | meaning                                                    | shape  | unit       |
|--------|---------------|------------------------------------------------------------|--------|------------|
| X_t    | `value`       | rollout t in test order; in [a, b]                         | ()     | unit X     |
| mu     |               | its mean as a function of the start                        |        | unit X     |
| m0     | `prior_mean`  | the norm bound is about mu - m0                            | ()     | unit X     |
| B      | `rkhs_norm`   | bound of the norm of mu - m0                               | ()     | unit X     |
| x_i    |               | the q points of the design; rollout t is at one of them    | (q, p) | parameter  |
| c      |               | the m nodes, each with its cell                            | (m, p) | parameter  |
| u_t    | `GuessedMean` | guess of the mean of rollout t from those before it        | ()     | unit X     |
| v_t    |               | weight of rollout t for each node, from those before it    | (m,)   | 1/unit X   |
| S      |               | sum v_t u_t + ln(1 + v_t (X_t - u_t)), less ln(1/delta)    | (m,)   | -          |
| W_i    |               | sum of v_t over the rollouts at x_i; V = sum_i W_i         | (m, q) | 1/unit X   |
| G      |               | a number that sum_i W_i k(d, x_i) is not below in the cell | (m,)   | 1/unit X   |
| Q      |               | W' K W, the squared norm of sum_t v_t k_{x_t}              | (m,)   | 1/unit X^2 |
| kappa  |               | any positive number, which may depend on the data          | (m,)   | unit X     |

prod_t (1 + v_t (X_t - u_t)) exp(-v_t (mu(x_t) - u_t)) is a supermartingale for every node, because 1 + y <= exp(y). So
sum_t v_t mu(x_t) >= S for all n with probability 1 - delta, and then for every start d and every kappa > 0

    mu(d) >= m0 + kappa (S - m0 V) - B sqrt(1 - 2 kappa sum_i W_i k(d, x_i) + kappa^2 Q).

With a control g X_t is the value less g, whose mean given the start is 0; its range is then [a - max g, b - min g].

The least one over the nodes bounds the minimum of mu over the box without a union: were it false, then the bound of
the cell in which the minimum is, one fixed cell, would be false [B82].
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...gp.kernels import Floats
from .cells import NodeCells, has_bend
from .weights import CAP

EPSILON = 2.0**-52


@dataclass(frozen=True, slots=True)
class KrigingPremises:
    """The assumptions about X and mu, fixed before the first rollout; `ends` are a and b.

    Raises:
        ValueError: a number is not finite, B is not positive, the range is empty, or delta is not in (0, 1).

    """

    rkhs_norm: float
    prior_mean: float
    ends: tuple[float, float]
    delta: float

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not (math.isfinite(self.rkhs_norm) and self.rkhs_norm > 0):
            raise ValueError(f"rkhs_norm must be a positive finite number, not {self.rkhs_norm!r}")
        if not math.isfinite(self.prior_mean):
            raise ValueError(f"prior_mean must be finite, not {self.prior_mean!r}")
        if not -math.inf < self.ends[0] < self.ends[1] < math.inf:
            raise ValueError(f"the range of a rollout, {list(self.ends)}, must be finite and not empty")
        if not 0.0 < self.delta < 1.0:
            raise ValueError(f"delta must be in (0, 1), not {self.delta!r}")

    @property
    def cost(self) -> float:
        """ln(1/delta), rounded up."""
        return -math.log(self.delta) * (1.0 + 1e-14)

    @property
    def without_data(self) -> float:
        """The lower bound of mu before any rollout: |f| <= B, because k(z, z) = 1."""
        return max(self.prior_mean - self.rkhs_norm, self.ends[0])


class GuessedMean:
    """u_t: the mean of all rollouts before, and of one imaginary rollout of value m0, within the range of rollout t."""

    def __init__(self, premises: KrigingPremises) -> None:
        self._low, self._high = premises.ends
        self._sum, self._count = min(max(premises.prior_mean, self._low), self._high), 1

    @property
    def ends(self) -> tuple[float, float]:
        """The range of the next rollouts; a control changes it, as a function of the start and of earlier tests."""
        return self._low, self._high

    @ends.setter
    def ends(self, ends: tuple[float, float]) -> None:
        self._low, self._high = ends

    @property
    def value(self) -> float:
        """The guess for the next rollout."""
        return min(max(self._sum / self._count, self._low), self._high)

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the largest weight of the next rollout that leave at least 1 - CAP of every wealth."""
        return self.limits_at(self.value)

    def limits_at(self, u: float) -> tuple[float, float]:
        """Return the same for another guess `u` in [a, b]."""
        return -CAP / max(self._high - u, 1e-300), CAP / max(u - self._low, 1e-300)

    def after(self, mean: float, count: float) -> float:
        """Return the guess after `count` further rollouts of this mean."""
        found = (self._sum + count * mean) / (self._count + count)
        return min(max(found, self._low), self._high)

    def before(self, values: Sequence[float]) -> list[tuple[float, float, float]]:
        """Take rollouts, and return the guess and the limits before each of them.

        Raises:
            ValueError: a value is outside its range; nothing changes.

        """
        check_values(values, (self._low, self._high))
        found, total, count = [], self._sum, self._count
        for value in values:
            u = min(max(total / count, self._low), self._high)
            found.append((u, *self.limits_at(u)))
            total, count = total + value, count + 1
        self._sum, self._count = total, count
        return found


def check_values(values: Sequence[float], ends: tuple[float, float]) -> None:
    """Raise ValueError if a rollout is outside its range."""
    low, high = ends
    for value in values:
        if not low <= value <= high:
            raise ValueError(f"a rollout must be in [{low}, {high}], not {value!r}")


class KrigingBounds:
    """The martingale and the bound of every node; rollouts enter in test order.

    `planned` has the weight of a rollout at each point, for each node, (m, q); it is cut where a wealth could become
    negative. `kernel` is that between the points, (q, q), and `error` bounds its absolute error.
    """

    def __init__(
        self, planned: Floats, kernel: Floats, cells: NodeCells, premises: KrigingPremises, *, error: float = 1e-15
    ) -> None:
        self.premises, self._planned, self._kernel, self._cells, self._error = premises, planned, kernel, cells, error
        m, q = planned.shape
        self._guess = GuessedMean(premises)
        self._sum, self._moved = np.zeros(m), np.zeros(m)
        self._weights, self._absolute = np.zeros((m, q)), np.zeros((m, q))
        self._of_weights = np.zeros((q, m))  # sum_j W_j k(x_i, x_j)
        self._least = np.zeros_like(cells.kernel(0))  # of sum W_i k(d, x_i), on the subgrid
        self._squared = np.zeros(m)
        self._count = 0
        self._largest = max(abs(premises.ends[0]), abs(premises.ends[1]), premises.ends[1] - premises.ends[0])
        self.lower = np.full(m, premises.without_data)

    @property
    def rollouts(self) -> int:
        """Number of rollouts n."""
        return self._count

    def minimum(self) -> float:
        """Return the bound of the minimum of mu over the box, valid at 1 - delta for all n at once; unit X.
        Implements eq. (kriging) of [PB].

        Formula: the least running maximum over the nodes; the martingale of the one cell in which mu is least decides,
        for all n, so each of its bounds is valid and the largest counts.
        """
        return float(self.lower.min())

    def observe(self, point: int, values: Sequence[float], ends: tuple[float, float] | None = None) -> None:
        """Add the rollouts of one test at a point of the design, and raise the bounds; on an error nothing changes.

        `ends` is the range that earlier tests and the start give these rollouts, by default that of every one.

        Raises:
            ValueError: a value is outside its range.

        """
        if ends is not None:
            self._guess.ends = ends
            self._largest = max(self._largest, abs(ends[0]), abs(ends[1]), ends[1] - ends[0])
        total, planned = np.zeros(len(self._sum)), self._planned[:, point].copy()
        least, most = float(planned.min()), float(planned.max())
        # The guess and the limits are functions of the rollouts before, those of the same test included.
        for value, (u, low, high) in zip(values, self._guess.before(values), strict=True):
            # One plan for the whole budget: mixtures of plans, and plans made anew in stages, gave weaker bounds.
            v = planned if low <= least and most <= high else np.minimum(np.maximum(planned, low), high)
            self._sum += v * u + np.log1p(v * (value - u))
            total += v
        self._count += len(values)
        self._moved += np.abs(total)  # weights of one point have one sign
        self._add_weight(point, total)
        self.lower = np.maximum(self.lower, self.current(self.premises.cost))

    def plan(self, planned: Floats) -> None:
        """Take other weights (m, q) for the rollouts from now on; they may depend on those so far."""
        self._planned = planned

    def weights_at(self, u: float) -> Floats:
        """Return the weight of a rollout at each point for each node, (m, q), where the guess of its mean is `u`."""
        return np.clip(self._planned, *self._guess.limits_at(u))

    @property
    def guess(self) -> GuessedMean:
        """U of the next rollout."""
        return self._guess

    def empty(self) -> "KrigingBounds":
        """Return the state before the first rollout."""
        return KrigingBounds(self._planned, self._kernel, self._cells, self.premises, error=self._error)

    def ahead(self, totals: Floats, gains: Floats) -> "KrigingBounds":
        """Return the state after further rollouts with these sums of weights (m, q) and of S + ln(1/delta), (m,).

        It is for forecasts: such rollouts are no data, and `lower` stays that of the rollouts so far.
        """
        found = copy.copy(self)
        found._weights, found._of_weights = self._weights.copy(), self._of_weights.copy()
        found._absolute = self._absolute.copy()
        found._least, found._squared = self._least.copy(), self._squared.copy()
        for point in np.flatnonzero(np.any(totals != 0, axis=0)).tolist():
            found._add_weight(point, totals[:, point])
        found._moved = self._moved + np.abs(totals).sum(axis=1)
        return found.shifted(gains)

    def shifted(self, gains: Floats) -> "KrigingBounds":
        """Return the state with S larger by `gains` (m,)."""
        found = copy.copy(self)
        found._sum = self._sum + gains
        return found

    def current(self, cost: float) -> Floats:
        """Return the bound over every cell that the rollouts so far prove, (m,), unit X, where ln(1/delta) is `cost`.
        Implements eq. (kriging) of [PB].

        Formula: m0 + kappa A - B sqrt(1 - 2 kappa G + kappa^2 Q) at its best kappa, A = S - m0 V; never below m0 - B or
        a. Every step is rounded outward: a cancelled norm would claim too much.
        """
        m0, b = self.premises.prior_mean, self.premises.rkhs_norm
        largest = max(self._largest, abs(m0))
        # |ln(1 + y)| is at most 3.2 |y| for y >= -CAP, so that no term is larger than 5 |v| times this.
        rounding = EPSILON * (self._count + 10) * 6.0 * largest * self._moved
        gain = self._sum - cost - m0 * self._weights.sum(axis=1) - rounding
        least, spread = self._least.min(axis=0), self._absolute.sum(axis=1)
        lost = b * self._cells.reach
        if has_bend(self._cells.sag):
            both = self._best(gain, np.array([least, least - self._cells.sag * spread]), spread)
            found = np.maximum(both[0] - lost, both[1])
        else:
            found = self._best(gain, least, spread) - lost
        return np.asarray(np.minimum(np.maximum(m0 + found, self.premises.without_data), m0 + b), dtype=np.float64)

    def _best(self, gain: Floats, least: Floats, spread: Floats) -> Floats:
        """Return the largest of kappa A - B sqrt(...) over kappa, for every row of G, `least` (.., m)."""
        b, q = self.premises.rkhs_norm, np.maximum(self._squared, 1e-300)
        rest = np.maximum(1.0 - least * least / q, 0.0)
        room = b * b * q - gain * gain
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            kappa = least / q + np.sign(gain) * np.sqrt(gain * gain * rest / (q * room))
            # No largest kappa: sum v_t f(x_t) is more than B allows, and the bound as large as one likes.
            kappa = np.where(room > 0, kappa, np.where(gain > 0, 1e6 / np.sqrt(q), 0.0))
            kappa = np.where(np.isfinite(kappa), np.maximum(kappa, 0.0), 0.0)
        # Each of the n sums of G and Q loses less than 4 EPSILON of their largest terms.
        error = (self._error + 4.0 * EPSILON * (self._count + 100)) * (1.0 + kappa * spread) ** 2
        norm = np.sqrt(np.maximum(1.0 - 2.0 * kappa * least + kappa * kappa * self._squared, 0.0) + error)
        return np.asarray(kappa * gain - b * norm * (1.0 + 1e-14), dtype=np.float64)

    def _add_weight(self, point: int, total: Floats) -> None:
        self._squared += total * (2.0 * self._of_weights[point] + total)
        self._weights[:, point] += total
        self._absolute[:, point] = np.abs(self._weights[:, point])
        self._of_weights += self._kernel[point][:, None] * total
        self._least += total * self._cells.kernel(point)
