"""Random functions of exactly known norm, and their maximum over a box. Nothing here knows the orchestrator.

| symbol | name       | meaning                                               | shape  | unit   |
|--------|------------|-------------------------------------------------------|--------|--------|
| k      | `kernel`   | scikit-learn's Matern kernel, k(z, z) = 1             |        | -      |
| c_i, w | `centres`, `weights` | f = sum_i w_i k(., c_i)                     | (m, p), (m,) | m, unit J |
| B      | `norm`     | sqrt(w'K(c, c)w), by the definition of the norm       | ()     | unit J |
| Z      |            | the box [0, SIDE]^p                                   |        | m      |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from sklearn.gaussian_process.kernels import Matern

Floats = NDArray[np.float64]
Function = Callable[[Floats], Floats]

SIDE = 5.0
GRID = {1: 101, 2: 15, 3: 7}
"""Nodes per axis of the fine grid, by dimension."""
CENTRES = (1, 2, 6, 20)
"""A single centre makes the largest value that a norm allows: |f| = B at its centre."""


@dataclass(frozen=True, slots=True)
class Known:
    """A function of known norm."""

    kernel: Matern
    centres: Floats
    weights: Floats

    def __call__(self, z: Floats) -> Floats:
        """Return f at `z` (N, p), shape (N,)."""
        return np.asarray(self.kernel(z, self.centres) @ self.weights, dtype=np.float64)

    @property
    def norm(self) -> float:
        """The norm of f in the space of its kernel."""
        return math.sqrt(float(self.weights @ self.kernel(self.centres) @ self.weights))


def random_function(rng: np.random.Generator, dimension: int, *, nu: float, length_scale: float, norm: float) -> Known:
    """Return a function whose norm is `norm`, with random centres in the box and random weights."""
    kernel = Matern(length_scale, nu=nu)
    count = int(rng.choice(CENTRES))
    known = Known(kernel, rng.uniform(0.0, SIDE, (count, dimension)), rng.normal(size=count))
    return Known(kernel, known.centres, known.weights * (norm / known.norm))


def fine_points(rng: np.random.Generator, dimension: int, *functions: Known) -> Floats:
    """Return a grid over the box, 100 random points and the centres, where rough functions have their peaks; (N, p)."""
    axes = [np.linspace(0.0, SIDE, GRID[dimension])] * dimension
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dimension)
    return np.concatenate([grid, rng.uniform(0.0, SIDE, (100, dimension)), *(f.centres for f in functions)])


def maximum(function: Function, points: Floats, *, starts: int = 2) -> float:
    """Return the largest value at the `points` and at the ends of local searches from the best of them.

    It may be below the maximum over the box by what both miss, never above: no bound is counted as false for that.
    """
    values = function(points)
    box = [(0.0, SIDE)] * points.shape[1]
    best = float(values.max())
    for start in np.argsort(values)[-starts:]:
        found = minimize(lambda z: -float(function(z[None, :])[0]), points[start], bounds=box, method="L-BFGS-B")
        best = max(best, -float(found.fun))
    return best
