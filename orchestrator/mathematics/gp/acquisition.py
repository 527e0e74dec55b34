"""Maximisers of an acquisition function: on the nodes, and between them."""

from collections.abc import Callable, Sequence

import numpy as np

from .kernels import Floats

TIE = 1e-12
"""Values this close to the maximum count as equal, so that round-off never decides a proposal."""

RIVAL = 1e-9
"""A value this close to the maximum may be the maximum on another CPU, which rounds differently."""


def maximiser(values: Floats) -> int:
    """Return the lowest index whose value is within `TIE` of the maximum.

    Raises:
        ValueError: `values` is empty or contains a NaN.

    >>> maximiser(np.array([0.5, 1.0, 1.0 + 1e-13]))
    1

    """
    if values.size == 0:
        raise ValueError("no values to maximise over")
    top = values.max()
    if np.isnan(top):
        raise ValueError("the acquisition function is NaN at a node")
    # argmax of booleans is the first True: the lowest index of a tie.
    return int(np.argmax(values >= top - TIE))


def rival_node(values: Floats, nodes: Floats, x: Sequence[float]) -> int | None:
    """Return the node at `x` (p,) if another CPU could have chosen it as maximiser: within `RIVAL` of the maximum.

    >>> rival_node(np.array([0.5, 1.0, 1.0 - 1e-10]), np.array([[0.0], [1.0], [2.0]]), (2.0,))
    2
    """
    # `x` comes from a stored fact, so it may have any length and need not be a node.
    matches = np.flatnonzero((nodes == np.asarray(x)).all(axis=1)) if len(x) == nodes.shape[1] else np.zeros(0, int)
    # "not >=" instead of "<": a NaN anywhere is no rival either.
    if len(matches) == 0 or not values[matches[0]] >= values.max() - RIVAL:
        return None
    return int(matches[0])


def climb(value: Callable[[Floats], tuple[float, Floats]], start: Floats, low: Floats, high: Floats) -> Floats:
    """Return the local maximum that a climb from `start` within the box [low, high] ends at, shape (p,).

    `value` returns the acquisition function and its gradient; the method is L-BFGS-B.

    >>> z = climb(lambda z: (-float(z @ z), -2.0 * z), np.array([0.5]), np.array([-1.0]), np.array([1.0]))
    >>> abs(float(z[0])) < 1e-6
    True
    """
    # It takes .3 s of CPU to import, and only campaigns with `refine` climb.
    from scipy.optimize import minimize  # noqa: PLC0415

    def descent(z: Floats) -> tuple[float, Floats]:
        height, gradient = value(z)
        return -height, -gradient

    bounds = list(zip(low, high, strict=True))
    lowest = minimize(descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 20, "ftol": 1e-9})
    return np.asarray(lowest.x, dtype=np.float64)
