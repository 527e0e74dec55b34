"""Shares of the variation of a function that its parameters explain: Sobol indices, and main effects.

| symbol | name     | meaning                                                            | shape          |
|--------|----------|--------------------------------------------------------------------|----------------|
| f      | `values` | the function at every node of a lattice over the box               | (n_1, ..., n_p)|
| S_i    | `first`  | Var E[f \\| x_i] / Var f: what parameter i explains by itself        | (p,)           |
| T_i    | `total`  | E Var[f \\| all but x_i] / Var f: with all that it does with others  | (p,)           |

The parameters are independent and uniform over the box. Sources: Sobol 1993, Sensitivity estimates for nonlinear
mathematical models (first-order indices); Homma, Saltelli 1996, Importance measures in global sensitivity analysis of
nonlinear models (total indices); Gamboa, Gremaud, Klein, Lagnoux 2022, Global sensitivity analysis: a novel generation
of mighty estimators based on rank statistics (indices from one sample).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CONSTANT = 1e-12
"""Standard deviation, relative to the largest value, below which a function counts as constant: that is round-off."""


class Indices(NamedTuple):
    """Sobol indices of a function, (p,) each."""

    first: Floats
    total: Floats


def lattice_indices(values: Floats) -> Indices | None:
    """Return the Sobol indices of a function from its values at the nodes of a lattice; None if it is constant.

    The integrals are those of the trapezoidal rule on the nodes, edges included; nothing is sampled.

    Raises:
        ValueError: a value is not finite.

    >>> x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21), indexing="ij")
    >>> [each.round(3).tolist() for each in lattice_indices(3 * x + y)]
    [[0.9, 0.1], [0.9, 0.1]]
    >>> lattice_indices(np.ones((3, 3))) is None
    True

    """
    if not np.isfinite(values).all():
        raise ValueError("a value is not finite: an index needs the function at every node")
    axes = range(values.ndim)
    variance = _variance(values, tuple(axes))
    if variance.item() <= (CONSTANT * float(np.max(np.abs(values), initial=0.0))) ** 2:
        return None
    # By the trapezoidal rule, not by sampling (Saltelli, Jansen): every node is known, and no seed decides a digit.
    first, total = [], []
    for axis in axes:
        others = tuple(each for each in axes if each != axis)
        first.append(_variance(_averaged(values, others), (axis,)) / variance)
        total.append(_averaged(_variance(values, (axis,)), others) / variance)
    return Indices(*(np.clip(np.array([each.item() for each in found]), 0.0, 1.0) for found in (first, total)))


def lattice_effect(values: Floats, axis: int) -> Floats:
    """Return the main effect E[f | x_i] of a parameter at its nodes, (n_i,).

    >>> lattice_effect(np.array([[0.0, 2.0], [4.0, 6.0]]), 0).tolist()
    [1.0, 5.0]
    """
    others = tuple(each for each in range(values.ndim) if each != axis)
    return _averaged(values, others).ravel()


def sample_indices(x: Floats, y: Floats) -> Floats | None:
    """Return an estimate of the first-order indices, (p,), from n independent pairs x (n, p), y (n,); None if constant.

    The tests in the order of x_i: S_i = (mean of y_k y_k+1 - mean(y)^2) / Var y, the last test followed by the first.
    Where y does not depend on x_i its standard deviation is about 1 / sqrt(n).

    >>> x = np.random.default_rng(1).uniform(size=(10_000, 2))
    >>> sample_indices(x, 3 * x[:, 0] + x[:, 1]).round(1).tolist()
    [0.9, 0.1]
    """
    centred = y - y.mean()
    variance = float(np.mean(centred**2))
    if variance <= (CONSTANT * float(np.max(np.abs(y), initial=0.0))) ** 2:
        return None
    order = np.argsort(x, axis=0, kind="stable")  # (n, p)
    sorted_y = centred[order]
    products = np.mean(sorted_y * np.roll(sorted_y, -1, axis=0), axis=0)
    return np.asarray(np.clip(products / variance, 0.0, 1.0))


def sample_effect(x: Floats, y: Floats, groups: int) -> tuple[Floats, Floats]:
    """Return the mean of x_i (n,) and that of y (n,) in groups of equally many tests, in the order of x_i.

    >>> at, mean = sample_effect(np.array([3.0, 0.0, 1.0, 2.0]), np.array([7.0, 1.0, 3.0, 5.0]), 2)
    >>> at.tolist(), mean.tolist()
    ([0.5, 2.5], [2.0, 6.0])
    """
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, groups)
    return np.array([x[part].mean() for part in parts]), np.array([y[part].mean() for part in parts])


def _weights(nodes: int) -> Floats:
    """Return the weights of the trapezoidal rule on [0, 1], (n,)."""
    weights = np.ones(nodes)
    if nodes > 1:
        weights[[0, -1]] = 0.5
    return np.asarray(weights / weights.sum())


def _averaged(values: Floats, axes: tuple[int, ...]) -> Floats:
    """Return the mean over some axes, which remain with length 1."""
    for axis in axes:
        shape = [1] * values.ndim
        shape[axis] = values.shape[axis]
        values = np.sum(values * _weights(values.shape[axis]).reshape(shape), axis=axis, keepdims=True)
    return values


def _variance(values: Floats, axes: tuple[int, ...]) -> Floats:
    return _averaged((values - _averaged(values, axes)) ** 2, axes)
