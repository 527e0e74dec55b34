"""Weights of method `kriging`: for every node the sum of rollouts that bounds the mean around it best.

| symbol | name        | meaning                                                      | shape  | unit      |
|--------|-------------|--------------------------------------------------------------|--------|-----------|
| x_i    |             | the q points of the design                                   | (q, p) | parameter |
| c      |             | the m nodes                                                  | (m, p) | parameter |
| k_c    | `to_nodes`  | kernel between nodes and points                              | (m, q) | -         |
| K      | `kernel`    | kernel between points                                        | (q, q) | -         |
| n_i    | `counts`    | rollouts that are planned at x_i                             | (q,)   | -         |
| w_i    | `w`         | weight of the mean of the rollouts at x_i                    | (m, q) | -         |
| kappa  | `kappa`     | price of one nat of confidence                               | ()     | unit X    |
| v_i    |             | weight of one rollout at x_i: w_i/(kappa n_i)                | (m, q) | 1/unit X  |
| B      | `rkhs_norm` | bound of the norm                                            | ()     | unit X    |
| s      | `spread`    | guess of the standard deviation of a rollout                 | ()     | unit X    |
| u      |             | guess of its mean                                            | ()     | unit X    |
| a, b   |             | ends of its range; `room_below` is u - a, `room_above` b - u | ()     | unit X    |

Minimised for each node over w and kappa, kappa on a grid of 7:

    B ||k_c - sum w_i k_i|| + kappa ln(1/delta) + (s^2/(2 kappa)) sum w_i^2/n_i,
    -kappa n_i cap/(b - u) <= w_i <= kappa n_i cap/(u - a).

It is what the bound is expected to lose. Nothing of it decides whether the bound is valid, only how tight it is: any
weights that are fixed beforehand are allowed.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...gp.kernels import Floats

CAP = 0.95
"""Largest share of the wealth of a martingale that one rollout may cost."""
KAPPAS = 7
# Half as many lose up to 0.004 of a bound, three times as many win 0.0005.
SWEEPS = 60
TIE = 1e-9
"""Losses this close, relative to B, count as equal, so that round-off chooses no kappa."""


@dataclass(frozen=True, slots=True)
class WeightTerms:
    """The numbers that the weights are planned for.

    Raises:
        ValueError: a number is not positive and finite, or delta is not in (0, 1).

    """

    rkhs_norm: float
    delta: float
    spread: float
    room_below: float
    room_above: float

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("rkhs_norm", "spread", "room_below", "room_above"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a positive finite number, not {value!r}")
        if not 0.0 < self.delta < 1.0:
            raise ValueError(f"delta must be in (0, 1), not {self.delta!r}")

    @property
    def cost(self) -> float:
        """ln(1/delta)."""
        return -math.log(self.delta)


def plan_weights(to_nodes: Floats, kernel: Floats, counts: Floats, terms: WeightTerms) -> tuple[Floats, Floats]:
    """Return v of every node and point, (m, q), per unit X, and what the bound of each node is expected to lose, (m,).
    Implements eq. (weights) of [PB].

    Formula: at the head of this module. For fixed kappa it is convex; coordinate descent, in which the norm is replaced
    by its tangent in the squared norm from above (||r|| <= (||r||^2/t + t)/2, equal at t = ||r||), so that no step
    raises the loss and every step has a closed form.

    >>> terms = WeightTerms(rkhs_norm=1.0, delta=0.05, spread=0.1, room_below=1.0, room_above=1.0)
    >>> kernel = np.array([[1.0, 0.2], [0.2, 1.0]])
    >>> v, losses = plan_weights(kernel, kernel, np.array([400.0, 400.0]), terms)
    >>> bool(v[0, 0] > 0.9 * v[0].sum()), bool(abs(v[0, 0] - v[1, 1]) < 1e-12)
    (True, True)

    """
    planned = counts > 0
    descent = _Descent(to_nodes[:, planned], kernel[np.ix_(planned, planned)], counts[planned], terms)
    best, found = np.full(len(to_nodes), np.inf), np.zeros_like(to_nodes)
    w = np.zeros_like(descent.to_nodes)
    for kappa in kappas(counts, terms):
        # From the weights of the kappa before, which are near.
        w = descent.weights(w, kappa)
        loss = descent.loss(w, kappa)
        better = loss < best - TIE * terms.rkhs_norm
        best = np.where(better, loss, best)
        found[np.ix_(better, planned)] = w[better] / (kappa * descent.n)
    return found, best


def kappas(counts: Floats, terms: WeightTerms) -> list[float]:
    """Return the grid of kappa: from about the best one where all rollouts count, to one where one point suffices."""
    total, most = float(counts.sum()), float(counts.max())
    shared = terms.spread / math.sqrt(2.0 * total * terms.cost)
    alone = max(terms.spread / math.sqrt(2.0 * most * terms.cost), terms.room_below / (CAP * most))
    # With less, even all rollouts together have weights that sum up to less than 1.
    least = max(1.5 * shared, terms.room_below / (CAP * total))
    return [float(each) for each in np.geomspace(least, 2.0 * alone, KAPPAS)]


@dataclass(frozen=True)
class _Descent:
    """Minimisation for fixed kappa over the points that have rollouts."""

    to_nodes: Floats
    kernel: Floats
    n: Floats
    terms: WeightTerms

    def weights(self, start: Floats, kappa: float) -> Floats:
        """Return w after the sweeps, (m, q)."""
        low, high = (end * kappa * self.n for end in (-CAP / self.terms.room_above, CAP / self.terms.room_below))
        w = np.clip(start, low, high)
        of_w = w @ self.kernel
        ridge = self.terms.spread**2 / (kappa * self.n * self.terms.rkhs_norm)  # of w_i^2, in units of B/2
        for _ in range(SWEEPS):
            norm = self.distance(w, of_w)
            for i in range(len(self.n)):
                target = self.to_nodes[:, i] - of_w[:, i] + w[:, i]
                moved = np.clip(target / (1.0 + ridge[i] * norm), low[i], high[i])
                of_w += (moved - w[:, i])[:, None] * self.kernel[i]
                w[:, i] = moved
        return w

    def distance(self, w: Floats, of_w: Floats) -> Floats:
        """Return ||k_c - sum w_i k_i|| of every node, (m,); `of_w` is K w."""
        squared = 1.0 + np.sum(w * (of_w - 2.0 * self.to_nodes), axis=1)
        return np.asarray(np.sqrt(np.maximum(squared, 1e-15)))

    def loss(self, w: Floats, kappa: float) -> Floats:
        """Return what is minimised, for every node, (m,)."""
        noise = self.terms.spread**2 / (2.0 * kappa) * np.sum(w * w / self.n, axis=1)
        found = self.terms.rkhs_norm * self.distance(w, w @ self.kernel) + kappa * self.terms.cost + noise
        return np.asarray(found, dtype=np.float64)
