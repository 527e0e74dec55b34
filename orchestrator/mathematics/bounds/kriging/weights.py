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
| r      |             | norm of k_c - sum w_i k_i                                    | (m,)   | -         |
| h      | `cell`      | norm of the difference of the kernel at the ends of a cell   | ()     | -         |
| B      | `rkhs_norm` | bound of the norm                                            | ()     | unit X    |
| s      | `spread`    | guess of the standard deviation of a rollout                 | ()     | unit X    |
| s'     |             | ((1.5 s)^2 + (B/6)^2)^(1/2)                                  | ()     | unit X    |
| u      |             | guess of its mean                                            | ()     | unit X    |
| a, b   |             | ends of its range; `room_below` is u - a, `room_above` b - u | ()     | unit X    |

Minimised for each node over w and kappa together:

    B (r^2 + h^2)^(1/2) + kappa ln(1/delta) + (s'^2/(2 kappa)) sum w_i^2/n_i,
    -kappa n_i cap/(b - u) <= w_i <= kappa n_i cap/(u - a).

It is what the bound is expected to lose, and convex: a norm, the perspective of a square, and linear limits. The bound
is for the cell of a node and not for the node alone: hence h. It is the least over all nodes, so that noise lowers it
by more than its mean: hence 1.5. And rollouts differ from u also because means differ from start to start, by B/6 as a
guess. Without the three the least r is bought with weights so large that noise loses more than they win, 0.005 of a
Segway bound. Nothing of it decides whether the bound is valid, only how tight it is: any weights that are fixed
beforehand are allowed.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...blocks import blocks
from ...gp.kernels import Floats

CAP = 0.95
"""Largest share of the wealth of a martingale that one rollout may cost."""
STEPS = 24
FIRST_BARRIER, LEAST_BARRIER = 0.1, 1e-7
"""Height of the barrier relative to B. It halves in each step; lower ones win less than 0.001 of B."""
TIP = 1e-3
"""Least h, without which r has a tip at 0, where Newton steps are of no use."""
TO_LIMIT = 0.95
"""A step goes this part of the way to a limit at most."""
TRIES = 8
SHORTER = 0.4
"""A step that raises what is minimised becomes this much shorter, so many times before it is left out."""
ROUND_OFF = 1e-12
OF_THE_LEAST = 1.5
"""Factor of the noise; from 1.25 to 2 it changes no bound by more than 0.001."""
OF_MEANS = 1.0 / 6.0
"""Of B: how far the mean at a start is from u."""
NUMBERS = 2**18
"""Of the matrices of nodes that are planned together: what is computed of them stays in the cache of a CPU."""


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
    cell: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("rkhs_norm", "spread", "room_below", "room_above"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a positive finite number, not {value!r}")
        if not 0.0 <= self.cell < math.inf:
            raise ValueError(f"cell must be a finite number of at least 0, not {self.cell!r}")
        if not 0.0 < self.delta < 1.0:
            raise ValueError(f"delta must be in (0, 1), not {self.delta!r}")

    @property
    def deviation(self) -> float:
        """The deviation s' of rollouts from u that the weights are planned for."""
        return math.hypot(OF_THE_LEAST * self.spread, OF_MEANS * self.rkhs_norm)

    @property
    def cost(self) -> float:
        """ln(1/delta)."""
        return -math.log(self.delta)


def plan_weights(to_nodes: Floats, kernel: Floats, counts: Floats, terms: WeightTerms) -> tuple[Floats, Floats]:
    """Return v of every node and point, (m, q), per unit X, and what the bound of each node is expected to lose, (m,).
    Implements eq. (weights) of [PB].

    Formula: at the head of this module, by Newton steps with a logarithmic barrier at each limit, which falls from step
    to step.

    >>> terms = WeightTerms(rkhs_norm=1.0, delta=0.05, spread=0.1, room_below=1.0, room_above=1.0)
    >>> kernel = np.array([[1.0, 0.2], [0.2, 1.0]])
    >>> v, losses = plan_weights(kernel, kernel, np.array([400.0, 400.0]), terms)
    >>> bool(v[0, 0] > 0.9 * v[0].sum()), bool(abs(v[0, 0] - v[1, 1]) < 1e-9)
    (True, True)

    """
    planned = counts > 0
    inner, n = kernel[np.ix_(planned, planned)], counts[planned]
    found, losses = np.zeros_like(to_nodes), np.empty(len(to_nodes))
    for part in blocks(len(to_nodes), (len(n) + 1) ** 2, NUMBERS):
        plan = _Plan(to_nodes[part][:, planned], inner, n, terms)
        plan.minimise()
        found[part, planned] = plan.w / (plan.kappa[:, None] * terms.rkhs_norm * n)
        losses[part] = terms.rkhs_norm * plan.loss(plan.w, plan.kappa)
    return found, losses


class _Plan:
    """Minimisation at some nodes, over the points that have rollouts; kappa and the loss relative to B."""

    def __init__(self, to_nodes: Floats, kernel: Floats, n: Floats, terms: WeightTerms) -> None:
        norm = terms.rkhs_norm
        self._to_nodes, self._kernel, self._n, self._cell = to_nodes, kernel, n, terms.cell
        self._variance, self._cost = (terms.deviation / norm) ** 2, terms.cost
        # Of w at kappa = 1.
        self._above, self._below = CAP * norm / terms.room_below * n, CAP * norm / terms.room_above * n
        self.w = np.zeros_like(to_nodes)
        self.kappa = np.full(len(to_nodes), self._usual_kappa(terms.deviation / norm, terms.room_below / norm))

    def minimise(self) -> None:
        """Take the steps."""
        barrier = FIRST_BARRIER
        for _ in range(STEPS):
            self._step(barrier)
            barrier = max(barrier / 2.0, LEAST_BARRIER)

    def loss(self, w: Floats, kappa: Floats) -> Floats:
        """Return what is minimised, (m,)."""
        noise = self._variance / (2.0 * kappa) * np.sum(w * w / self._n, axis=1)
        found: Floats = self._distance(w, w @ self._kernel) + kappa * self._cost + noise
        return found

    def _usual_kappa(self, spread: float, room: float) -> float:
        """Return about the best kappa, between that where all rollouts count and that where one point suffices."""
        total, most = float(self._n.sum()), float(self._n.max())
        alone, shared = (
            max(spread / math.sqrt(2.0 * count * self._cost), room / (CAP * count)) for count in (most, total)
        )
        return math.sqrt(alone * shared)

    def _step(self, barrier: float) -> None:
        """Take a Newton step of every node, as long as the limits allow and the barrier counts."""
        to_w, to_kappa = self._newton(barrier)
        before = self._with_barrier(self.w, self.kappa, barrier)
        length = np.minimum(1.0, TO_LIMIT * self._room(to_w, to_kappa))
        for _ in range(TRIES):
            w, kappa = self.w + length[:, None] * to_w, self.kappa + length * to_kappa
            raises = ~(self._with_barrier(w, kappa, barrier) <= before + ROUND_OFF)
            if not raises.any():
                break
            length[raises] *= SHORTER
        taken = ~raises
        self.w[taken], self.kappa[taken] = w[taken], kappa[taken]

    def _newton(self, barrier: float) -> tuple[Floats, Floats]:
        """Return the Newton steps of w and kappa."""
        w, kappa, q = self.w, self.kappa[:, None], len(self._n)
        of_w = w @ self._kernel
        pull, r = of_w - self._to_nodes, self._distance(w, of_w)[:, None]
        above, below = kappa * self._above - w, w + kappa * self._below
        squares = np.sum(w * w / self._n, axis=1)
        slope = np.empty((len(w), q + 1, 1))
        slope[:, :q, 0] = pull / r + self._variance * w / (kappa * self._n) + barrier * (1.0 / above - 1.0 / below)
        of_limits = np.sum(self._above / above + self._below / below, axis=1)
        slope[:, q, 0] = self._cost - self._variance * squares / (2.0 * self.kappa**2) - barrier * of_limits
        curve = np.empty((len(w), q + 1, q + 1))
        curve[:, :q, :q] = self._kernel / r[:, :, None] - (pull / r**3)[:, :, None] * pull[:, None, :]
        places = np.arange(q)
        curve[:, places, places] += self._variance / (kappa * self._n) + barrier * (1.0 / above**2 + 1.0 / below**2)
        mixed = barrier * (self._below / below**2 - self._above / above**2) - self._variance * w / (kappa**2 * self._n)
        curve[:, :q, q] = curve[:, q, :q] = mixed
        of_limits = np.sum((self._above / above) ** 2 + (self._below / below) ** 2, axis=1)
        curve[:, q, q] = self._variance * squares / self.kappa**3 + barrier * of_limits
        found = np.asarray(np.linalg.solve(curve, -slope)[:, :, 0], dtype=np.float64)
        return found[:, :q], found[:, q]

    def _with_barrier(self, w: Floats, kappa: Floats, barrier: float) -> Floats:
        """Return what a step lowers, (m,); NaN beyond a limit, which lies in no comparison."""
        with np.errstate(invalid="ignore", divide="ignore"):
            above, below = kappa[:, None] * self._above - w, w + kappa[:, None] * self._below
            found: Floats = self.loss(w, kappa) - barrier * np.sum(np.log(above) + np.log(below), axis=1)
        return found

    def _room(self, to_w: Floats, to_kappa: Floats) -> Floats:
        """Return how many steps are left to the nearest limit, (m,)."""
        kappa, change = self.kappa[:, None], to_kappa[:, None]
        left = np.hstack([kappa * self._above - self.w, self.w + kappa * self._below])
        lost = np.hstack([to_w - change * self._above, -to_w - change * self._below])
        nearest: Floats = np.max(lost / left, axis=1)
        return 1.0 / np.maximum(nearest, TO_LIMIT)

    def _distance(self, w: Floats, of_w: Floats) -> Floats:
        """Return (r^2 + h^2)^(1/2) of every node, (m,); `of_w` is K w."""
        squared = 1.0 + np.sum(w * (of_w - 2.0 * self._to_nodes), axis=1)
        found: Floats = np.sqrt(np.maximum(squared, 0.0) + max(self._cell, TIP) ** 2)
        return found
