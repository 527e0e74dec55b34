"""Choosing the next point: the maximiser of an acquisition function on the lattice, and near it."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import minimize

from .kernels import Floats

TIE = 1e-12
"""Values this close to the maximum count as equal, so that round-off never decides a proposal."""

RIVAL = 1e-9
"""How far below the maximum a value may be that was the maximum on another CPU."""


def maximiser(values: Floats) -> int:
    """Return the lowest index whose value is within `TIE` of the maximum.

    Raises:
        ValueError: `values` is empty or holds a NaN.

    >>> maximiser(np.array([0.5, 1.0, 1.0 + 1e-13]))
    1

    """
    if values.size == 0:
        raise ValueError("no values to maximise over")
    top = values.max()
    if np.isnan(top):
        raise ValueError("the acquisition function is NaN at a node")
    return int(np.argmax(values >= top - TIE))


def rivals(values: Floats, nodes: Floats, x: Sequence[float]) -> int | None:
    """Return the node at `x` (p,) if another CPU could have taken it for the maximiser: within `RIVAL` of the maximum.

    >>> rivals(np.array([0.5, 1.0, 1.0 - 1e-10]), np.array([[0.0], [1.0], [2.0]]), (2.0,))
    2
    """
    found = np.flatnonzero((nodes == np.asarray(x)).all(axis=1)) if len(x) == nodes.shape[1] else np.zeros(0, int)
    if len(found) == 0 or not values[found[0]] >= values.max() - RIVAL:
        return None
    return int(found[0])


def refined(value: Callable[[Floats], tuple[float, Floats]], start: Floats, low: Floats, high: Floats) -> Floats:
    """Climb from `start` within the box [low, high] and return where that ends, shape (p,).

    `value` returns the acquisition function and its gradient; the method is L-BFGS-B.

    >>> z = refined(lambda z: (-float(z @ z), -2.0 * z), np.array([0.5]), np.array([-1.0]), np.array([1.0]))
    >>> abs(float(z[0])) < 1e-6
    True
    """

    def descent(z: Floats) -> tuple[float, Floats]:
        found, gradient = value(z)
        return -found, -gradient

    bounds = list(zip(low, high, strict=True))
    found = minimize(descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 20, "ftol": 1e-9})
    return np.asarray(found.x, dtype=np.float64)
