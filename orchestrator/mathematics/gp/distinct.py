"""Distinct observed points, and the kernel among them and between them and the nodes.

| symbol   | name       | meaning                                                 | shape  | unit     |
|----------|------------|---------------------------------------------------------|--------|----------|
| q        | `len()`    | distinct observed points                                | ()     | -        |
| m        |            | number of nodes                                         | ()     | -        |
| X        |            | distinct points, in order of first observation          | (q,)   | -        |
|          | `indices`  | X as indices of nodes                                   | (q,)   | -        |
|          | `places`   | X as coordinates                                        | (q, p) | parameter |
| K(X, .)  | `kernel`   | kernel between X and every node                         | (q, m) | -        |
| K(X, X)  | `gram`     | kernel matrix of X                                      | (q, q) | -        |

Memory: O(q (m + q)). A campaign that samples by UCB returns to few points: 2,000 tests of the paper's function on
51 x 51 nodes have about 20.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .kernels import Floats, scaled
from .radial import Radial

Point = int | tuple[float, ...]
"""A node by its index, or any point of the box by its coordinates; one kind throughout a campaign."""

_FIRST_CAPACITY = 16


class Rows(Protocol):
    """Kernel rows over the nodes of a `Lattice` or of `Points`."""

    size: int

    def row(self, point: int) -> Floats:
        """Return k(point, all nodes), shape (m,)."""
        ...


@dataclass(frozen=True, slots=True)
class OffNodeKernel:
    """The kernel at points that need not be nodes: `radial` is the kernel of the rows as a function of distance."""

    nodes: Floats  # (m, p)
    radial: Radial

    def between(self, places: Floats, z: Floats) -> Floats:
        """Return k(places, z), shape (N,), for `places` (N, p)."""
        return self.radial.value(np.linalg.norm(scaled(places - z, self.radial.axes), axis=1))

    def gradient(self, places: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Return k(places, z), shape (N,), and its gradient in z, shape (N, p); 0 at a place itself.

        Formula: grad = (k'(r)/r) (z - place), each component divided by its length scale twice where there is one per
        axis.
        """
        step = scaled(z - places, self.radial.axes)
        value, slope = self.radial.value_and_slope(np.linalg.norm(step, axis=1))
        return value, scaled(slope[:, None] * step, self.radial.axes)


class DistinctPoints:
    """Points in order of first observation, with their kernel rows; a point that is added keeps its position."""

    def __init__(self, rows: Rows, off_nodes: OffNodeKernel | None = None) -> None:
        self._rows, self._off_nodes = rows, off_nodes
        self._position: dict[Point, int] = {}
        self._kernel = np.empty((_FIRST_CAPACITY, rows.size))
        self._gram = np.empty((_FIRST_CAPACITY, _FIRST_CAPACITY))
        self._places = np.empty((_FIRST_CAPACITY, off_nodes.nodes.shape[1] if off_nodes else 0))

    def __len__(self) -> int:
        return len(self._position)

    @property
    def indices(self) -> list[int]:
        """X as indices, where the points are nodes."""
        return [point for point in self._position if isinstance(point, int)]

    @property
    def places(self) -> Floats:
        """Coordinates of X, shape (q, p); (q, 0) without `off_nodes`."""
        return self._places[: len(self)]

    @property
    def kernel(self) -> Floats:
        """K(X, nodes), shape (q, m)."""
        return self._kernel[: len(self)]

    @property
    def gram(self) -> Floats:
        """K(X, X), shape (q, q)."""
        return self._gram[: len(self), : len(self)]

    def row(self, point: Point) -> tuple[Floats, Floats]:
        """Return k(point, nodes), shape (m,), and k(point, X), shape (q,).

        Raises:
            IndexError: no node has this index.

        """
        position = self._position.get(point)
        if position is not None:
            return self.kernel[position], self.gram[position]
        if isinstance(point, int):
            row = self._rows.row(point)
            return row, row[self.indices]
        assert self._off_nodes is not None, "points off the nodes need `off_nodes`"
        z = np.array(point)
        return self._off_nodes.between(self._off_nodes.nodes, z), self._off_nodes.between(self.places, z)

    def gradient(self, z: Floats) -> tuple[Floats, Floats]:
        """Return k(X, z), shape (q,), and its gradient in z, shape (q, p), for any point `z` (p,) of the box."""
        assert self._off_nodes is not None, "points off the nodes need `off_nodes`"
        return self._off_nodes.gradient(self.places, z)

    def position(self, point: Point) -> int:
        """Return the position of `point` in X, which is added if it is new; on an error nothing changes.

        Raises:
            IndexError: no node has this index.

        """
        if point not in self._position:
            self._add(point)
        return self._position[point]

    def _add(self, point: Point) -> None:
        row, among = self.row(point)
        self._reserve()
        q = len(self)
        self._kernel[q] = row
        # One evaluation fills both triangles: K(X, X) is symmetric to the bit.
        self._gram[q, :q] = self._gram[:q, q] = among
        self._gram[q, q] = 1.0  # unit amplitude: k(0) = 1
        if not isinstance(point, int):
            self._places[q] = point
        self._position[point] = q

    def _reserve(self) -> None:
        """Make room for one more point by doubling; rows that exist keep their bits."""
        q = len(self)
        if q == len(self._kernel):
            self._kernel = _enlarge(self._kernel, (2 * q, self._kernel.shape[1]))
            self._gram = _enlarge(self._gram, (2 * q, 2 * q))
            self._places = _enlarge(self._places, (2 * q, self._places.shape[1]))


def _enlarge(old: Floats, shape: tuple[int, int]) -> Floats:
    """Return an array of `shape` that begins with `old`; the rest is not initialised."""
    new = np.empty(shape)
    new[: old.shape[0], : old.shape[1]] = old
    return new
