"""Observations of a Gaussian process: the values at distinct points, repeats merged.

| symbol   | name       | meaning                                                 | shape  | unit     |
|----------|------------|---------------------------------------------------------|--------|----------|
| n        | `n`        | observations                                            | ()     | -        |
| q, X     | `points`   | distinct observed points, see `gp.distinct`             | (q,)   | -        |
| c        | `counts`   | observations per point                                  | (q,)   | -        |
| ybar     | `means`    | their means, centred by m0                              | (q,)   | unit J   |
| S        | `within`   | sum of squares within the points                        | ()     | unit J^2 |
"""

import math

import numpy as np

from .distinct import DistinctPoints, OffNodeKernel, Point, Rows
from .kernels import Floats

LARGEST_Y = 1e100


class Observations:
    """Observations in test order; the state is a function of the calls made."""

    def __init__(self, rows: Rows, off_nodes: OffNodeKernel | None = None) -> None:
        self.points = DistinctPoints(rows, off_nodes)
        self._order: list[int] = []
        self._y: list[list[float]] = []

    @property
    def n(self) -> int:
        """Number of observations."""
        return len(self._order)

    @property
    def counts(self) -> Floats:
        """Observations per point, shape (q,)."""
        return np.array([len(values) for values in self._y], dtype=np.float64)

    @property
    def means(self) -> Floats:
        """Mean observation of each point, shape (q,), unit of J."""
        # fsum is exact before its one rounding, so a mean does not depend on the order of the repeats.
        return np.array([math.fsum(values) / len(values) for values in self._y])

    @property
    def within(self) -> float:
        """Sum of squared deviations from the means, in the squared unit of J."""
        means = self.means.tolist()
        return math.fsum((v - mean) ** 2 for values, mean in zip(self._y, means, strict=True) for v in values)

    @property
    def first_repeat(self) -> int:
        """Number of the first observation at a point that was observed before; n if there is none."""
        return next((i for i, position in enumerate(self._order) if position in self._order[:i]), self.n)

    def first(self, position: int) -> int:
        """Return the number of the first observation at a point."""
        return self._order.index(position)

    def append(self, point: Point, y: float) -> int:
        """Add the centred observation `y` at `point` and return the point's position; on an error nothing changes.

        Raises:
            IndexError: no node has this index.
            ValueError: `y` is not finite, or its square could overflow.

        """
        self.check(y)
        position = self.points.position(point)
        if position == len(self._y):
            self._y.append([])
        self._y[position].append(y)
        self._order.append(position)
        return position

    def check(self, y: float) -> None:
        """Raise ValueError if `y` cannot be observed."""
        if not abs(y) <= LARGEST_Y:  # in this form a NaN fails as well
            raise ValueError(f"observation {self.n} is {y!r}, not a finite number of at most {LARGEST_Y:g}")
