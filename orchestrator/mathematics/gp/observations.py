"""What was observed where: distinct points with their kernel rows, repeats merged.

| symbol   | name       | meaning                                                 | shape  | unit     |
|----------|------------|---------------------------------------------------------|--------|----------|
| n, q     | `n`, `q`   | observations, distinct observed points                  | ()     | -        |
| m        |            | number of nodes                                         | ()     | -        |
| X        | `points`   | distinct points, in order of first observation          | (q,)   | -        |
| K(X, .)  | `kernel`   | kernel between X and every node                         | (q, m) | -        |
| K(X, X)  | `gram`     | kernel matrix of X                                      | (q, q) | -        |
| c        | `counts`   | observations per point                                  | (q,)   | -        |
| ybar     | `means`    | their means, centred by m0                              | (q,)   | unit J   |
| S        | `within`   | sum of squares within the points                        | ()     | unit J^2 |

Memory: O(q (m + q)). A campaign that samples by UCB comes back to few points: 2,000 tests of the paper's function on
51 x 51 nodes have about 20.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .kernels import Floats
from .radial import Radial

Point = int | tuple[float, ...]
"""A node by its index, or any point of the box by its coordinates; one kind throughout a campaign."""

LARGEST_Y = 1e100

_FIRST_CAPACITY = 16


class Rows(Protocol):
    """Kernel rows over the nodes of a `Lattice` or of `Points`."""

    size: int

    def row(self, point: int) -> Floats:
        """Return k(point, all nodes), shape (m,)."""
        ...


@dataclass(frozen=True, slots=True)
class Anywhere:
    """The kernel at points that need not be nodes: `radial` is the kernel of the rows as a function of distance."""

    nodes: Floats  # (m, p)
    radial: Radial

    def between(self, places: Floats, z: Floats) -> Floats:
        """Return k(places, z), shape (N,), for `places` (N, p)."""
        return self.radial.value(np.linalg.norm(places - z, axis=1))

    def toward(self, places: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Return k(places, z), shape (N,), and its gradient in z, shape (N, p); 0 at a place itself.

        Formula: grad = (k'(r)/r) (z - place).
        """
        step = z - places
        value, slope = self.radial.climb(np.linalg.norm(step, axis=1))
        return value, slope[:, None] * step


class Observations:
    """Observations in test order; the state is a function of the calls made."""

    def __init__(self, rows: Rows, anywhere: Anywhere | None = None) -> None:
        self._rows, self._anywhere = rows, anywhere
        self._order: list[int] = []
        self._position: dict[Point, int] = {}
        self._y: list[list[float]] = []
        self._k = np.empty((_FIRST_CAPACITY, rows.size))
        self._gram = np.empty((_FIRST_CAPACITY, _FIRST_CAPACITY))
        self._places = np.empty((_FIRST_CAPACITY, anywhere.nodes.shape[1] if anywhere else 0))

    @property
    def n(self) -> int:
        """Number of observations."""
        return len(self._order)

    @property
    def q(self) -> int:
        """Number of distinct points."""
        return len(self._y)

    @property
    def points(self) -> list[Point]:
        """Distinct points, in order of first observation."""
        return list(self._position)

    @property
    def indices(self) -> list[int]:
        """X as indices, where the points are nodes."""
        return [point for point in self._position if isinstance(point, int)]

    @property
    def places(self) -> Floats:
        """Coordinates of X, shape (q, p); (q, 0) without `anywhere`."""
        return self._places[: self.q]

    @property
    def kernel(self) -> Floats:
        """K(X, nodes), shape (q, m)."""
        return self._k[: self.q]

    @property
    def gram(self) -> Floats:
        """K(X, X), shape (q, q)."""
        return self._gram[: self.q, : self.q]

    @property
    def counts(self) -> Floats:
        """Observations per point, shape (q,)."""
        return np.array([len(values) for values in self._y], dtype=np.float64)

    @property
    def means(self) -> Floats:
        """Mean observation of each point, shape (q,), unit of J."""
        return np.array([math.fsum(values) / len(values) for values in self._y])

    @property
    def within(self) -> float:
        """Sum of squared deviations from the means, in the squared unit of J."""
        means = self.means.tolist()
        return math.fsum((v - mean) ** 2 for values, mean in zip(self._y, means, strict=True) for v in values)

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
        assert self._anywhere is not None, "points off the nodes need `anywhere`"
        z = np.array(point)
        return self._anywhere.between(self._anywhere.nodes, z), self._anywhere.between(self.places, z)

    def append(self, point: Point, y: float) -> int:
        """Add the centred observation `y` at `point` and return the point's position; on an error nothing changes.

        Raises:
            IndexError: no node has this index.
            ValueError: `y` is not finite, or its square could overflow.

        """
        self.check(y)
        if point not in self._position:
            self._add(point)
        position = self._position[point]
        self._y[position].append(y)
        self._order.append(position)
        return position

    def check(self, y: float) -> None:
        """Raise ValueError if `y` cannot be observed."""
        if not abs(y) <= LARGEST_Y:
            raise ValueError(f"observation {self.n} is {y!r}, not a finite number of at most {LARGEST_Y:g}")

    def toward(self, z: Floats) -> tuple[Floats, Floats]:
        """Return k(X, z), shape (q,), and its gradient in z, shape (q, p), for any point `z` (p,) of the box."""
        assert self._anywhere is not None, "points off the nodes need `anywhere`"
        return self._anywhere.toward(self.places, z)

    def first(self, position: int) -> int:
        """Return the number of the first observation at a point."""
        return self._order.index(position)

    @property
    def first_repeat(self) -> int:
        """Number of the first observation at a point that was known; n if there is none."""
        return next((i for i, position in enumerate(self._order) if position in self._order[:i]), self.n)

    def _add(self, point: Point) -> None:
        row, among = self.row(point)
        self._reserve()
        q = self.q
        self._k[q] = row
        self._gram[q, :q] = self._gram[:q, q] = among
        self._gram[q, q] = 1.0
        if not isinstance(point, int):
            self._places[q] = point
        self._position[point] = q
        self._y.append([])

    def _reserve(self) -> None:
        """Make room for one more point by doubling; old rows keep their bits."""
        q = self.q
        if q < len(self._k):
            return
        shapes = {"_k": (2 * q, self._k.shape[1]), "_gram": (2 * q, 2 * q), "_places": (2 * q, self._places.shape[1])}
        for name, shape in shapes.items():
            old: Floats = getattr(self, name)
            new = np.empty(shape)
            new[: old.shape[0], : old.shape[1]] = old
            setattr(self, name, new)
