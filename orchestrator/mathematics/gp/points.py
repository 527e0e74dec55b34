"""A finite list of candidate points with its kernel rows, and `Candidates`: such a list or a lattice.

| symbol   | name       | meaning                              | shape  | unit      |
|----------|------------|--------------------------------------|--------|-----------|
| p        |            | number of parameters                 | ()     | -         |
| m        | `size`     | number of points                     | ()     | -         |
| z_j      | `nodes`    | point j, in the order given          | (m, p) | parameter |
| k(z_i)   | `row(i)`   | kernel between point i and every one | (m,)   | -         |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .kernels import Floats, squared_distances
from .lattice import Lattice, check_index

MAX_POINTS = 5_000
TABLE = 1_000
"""Points up to which all kernel rows are computed at once: 8 MB. Of more points a campaign tests few."""


@dataclass(frozen=True, slots=True)
class Points:
    """The points of a finite D; with the part of the interface of `Lattice` that the methods use.

    Raises:
        ValueError: no point, too many, differing lengths, a coordinate that is not finite, or a point listed twice.

    >>> Points(((0.5, 0.5), (1.5, 0.5))).nodes.tolist()
    [[0.5, 0.5], [1.5, 0.5]]

    """

    points: tuple[tuple[float, ...], ...]
    nodes: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Validate the list and store it as an array."""
        points = tuple(tuple(float(v) for v in point) for point in self.points)
        _validate(points)
        object.__setattr__(self, "points", points)
        nodes = np.array(points)  # (m, p)
        nodes.flags.writeable = False
        object.__setattr__(self, "nodes", nodes)

    @property
    def size(self) -> int:
        """Number of points m."""
        return len(self.points)

    def kernel_rows(self, kernel: Callable[[Floats], Floats], axes: Floats | None = None) -> "PointRows":
        """Return k(z_i, all points) by index; the kernel is evaluated here, at distances in `axes` if given."""
        return PointRows(self, kernel, axes)


class PointRows:
    """Kernel rows of a list of points; k(z_i, z_j) = k(z_j, z_i) bit by bit.

    A distance is the same in both directions, and the kernel depends on it alone.
    """

    def __init__(self, points: Points, kernel: Callable[[Floats], Floats], axes: Floats | None = None) -> None:
        self.size = points.size
        self._points, self._kernel, self._axes = points.nodes, kernel, axes
        self._rows: dict[int, Floats] = {}
        if self.size <= TABLE:
            self._rows = dict(enumerate(self._computed(slice(None))))

    def row(self, index: int) -> Floats:
        """Return k(z_index, all points), shape (m,).

        Raises:
            IndexError: no point has this index.

        """
        check_index(index, self.size)
        if index not in self._rows:
            self._rows[index] = self._computed(slice(index, index + 1))[0]
        return np.asarray(self._rows[index], dtype=np.float64)

    def _computed(self, rows: slice) -> Floats:
        return self._kernel(np.sqrt(squared_distances(self._points[rows], self._points, self._axes)))


Candidates = Lattice | Points
"""The set Z that tests are chosen from: a box, represented by the nodes of a lattice, or a finite list."""


def point_at(candidates: Candidates, index: int) -> tuple[float, ...]:
    """Return the parameters of a candidate, shape (p,).

    Raises:
        IndexError: no candidate has this index.

    """
    check_index(index, candidates.size)
    return tuple(candidates.nodes[index].tolist())


def _validate(points: tuple[tuple[float, ...], ...]) -> None:
    if not points:
        raise ValueError("a list of points needs at least one point")
    if len(points) > MAX_POINTS:
        raise ValueError(f"{len(points)} points exceed {MAX_POINTS}: shorten the list, or take a box with a lattice")
    numbers: dict[tuple[float, ...], int] = {}
    for number, point in enumerate(points):
        if not point or len(point) != len(points[0]):
            raise ValueError(f"point {number} has {len(point)} coordinates and point 0 has {len(points[0])}")
        if not all(math.isfinite(v) for v in point):
            raise ValueError(f"point {number} is {point}; coordinates must be finite")
        # Two equal points have two equal kernel rows: a singular matrix without noise.
        if point in numbers:
            raise ValueError(f"points {numbers[point]} and {number} are the same, {point}: list each one once")
        numbers[point] = number
