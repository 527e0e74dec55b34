"""Cells around the nodes of a lattice, and the least value of a sum of kernels over each of them.

| symbol | name        | meaning                                                         | shape     | unit      |
|--------|-------------|-----------------------------------------------------------------|-----------|-----------|
| c      |             | nodes; the cell of c is the part of the box nearest to it       | (m, p)    | parameter |
| d      |             | points of a subgrid of every cell, its edges included           | (m, s, p) | parameter |
| x_i    |             | points of the design                                            | (q, p)    | parameter |
|        | `kernel(i)` | k(d, x_i)                                                       | (s, m)    | -         |
| h      |             | distances of neighbouring points of a subgrid, in length scales | (p,)      | -         |
|        | `sag`       | sum_j h_j^2/8 times the largest absolute k''                    | (m,)      | -         |
|        | `reach`     | d_k of half the diagonal of h                                   | (m,)      | -         |

Between the points of a subgrid a sum g = sum W_i k_{x_i} is not lower than its least value on them by more than `sag`
sum |W_i|: multilinear interpolation is a mean of corner values, its error along one axis is at most h^2/8 max |g''|,
and that of several axes their sum. And no function of norm 1 differs by more than `reach` from its value at the nearest
point. Both are certified; which is tighter depends on the kernel and on the data. Kernels with a kink have no k''.
"""

import math
from itertools import product

import numpy as np

from ...gp.kernels import Floats, scaled
from ...gp.lattice import Lattice
from ...gp.radial import Radial

PER_AXIS = {1: 9, 2: 5, 3: 3, 4: 3, 5: 2, 6: 2}
"""Points of the subgrid of a cell per axis, by the number of axes."""


class NodeCells:
    """The cells of a lattice with their subgrids; kernel values between them and the design are kept."""

    def __init__(self, lattice: Lattice, radial: Radial, points: Floats) -> None:
        low, high, half = np.array(lattice.low), np.array(lattice.high), np.array(lattice.spacing) / 2.0
        first = np.maximum(lattice.nodes - half, low)  # (m, p)
        sides = np.minimum(lattice.nodes + half, high) - first
        count = PER_AXIS[lattice.dimension]
        offsets = np.array(list(product(np.linspace(0.0, 1.0, count), repeat=lattice.dimension)))  # (s, p)
        subgrid = scaled(first[:, None, :] + sides[:, None, :] * offsets, radial.axes)  # (m, s, p)
        steps = scaled(sides, radial.axes) / (count - 1)  # (m, p)
        self.sag = np.sum(steps**2, axis=1) / 8.0 * radial.largest_bend * (1.0 + 1e-12)
        diagonals, inverse = np.unique(np.sqrt(np.sum(steps**2, axis=1)) / 2.0, return_inverse=True)
        self.reach = np.array([radial.distance(each) for each in diagonals.tolist()])[inverse] + 1e-12
        # Cells side by side: minima over the subgrid take an eighth of the time.
        kernels = (_kernel_at(radial, subgrid, each) for each in scaled(points, radial.axes))
        self._kernel = [np.ascontiguousarray(each.T) for each in kernels]

    def kernel(self, i: int) -> Floats:
        """Return k(d, x_i) at the subgrid of every cell, (s, m)."""
        return self._kernel[i]


def between(radial: Radial, first: Floats, second: Floats) -> Floats:
    """Return the kernel between two lists of points (m, p) and (q, p), shape (m, q)."""
    return np.stack(
        [_kernel_at(radial, scaled(first, radial.axes), each) for each in scaled(second, radial.axes)], axis=1
    )


def _kernel_at(radial: Radial, points: Floats, other: Floats) -> Floats:
    difference = points - other
    return radial.value(np.sqrt(np.sum(difference * difference, axis=-1)))


def has_bend(sag: Floats) -> bool:
    """Whether the kernel has a bounded second derivative, so that `sag` is of use."""
    return math.isfinite(float(sag.max()))
