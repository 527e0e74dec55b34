"""The regular lattice of candidate points, and kernel rows over it.

| symbol | name         | meaning                                      | shape    | unit      |
|--------|--------------|----------------------------------------------|----------|-----------|
| p      | `dimension`  | number of parameters                         | ()       | -         |
| m      | `size`       | number of nodes, resolution^p                | ()       | -         |
| z_j    | `nodes`      | node j; the last axis runs fastest           | (m, p)   | parameter |
| k(z_i) | `row(i)`     | kernel between node i and every node         | (m,)     | -         |
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from .kernels import Floats, scaled

MAX_NODES = 250_000
"""Above this a posterior of 600 tests would need more than 2.4 GB."""
PARTS = 16
"""Intervals between two neighbouring nodes, for points off the nodes: at most 1/32 of a cell is lost."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """`resolution` equally spaced nodes per axis of the box [low, high], edges included.

    Raises:
        ValueError: the box is empty or not finite, its sides differ in length, `resolution` < 2, or too many nodes.

    >>> Lattice((0.0, 0.0), (5.0, 5.0), 51).nodes[52].tolist()
    [0.1, 0.1]

    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    resolution: int
    nodes: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Validate the box and lay out the nodes."""
        object.__setattr__(self, "low", tuple(float(v) for v in self.low))
        object.__setattr__(self, "high", tuple(float(v) for v in self.high))
        self._validate()
        axes = [np.linspace(a, b, self.resolution) for a, b in zip(self.low, self.high, strict=True)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, self.dimension)  # (m, p)
        nodes.flags.writeable = False  # frozen like the lattice itself
        object.__setattr__(self, "nodes", nodes)

    def _validate(self) -> None:
        if not self.low or len(self.low) != len(self.high):
            raise ValueError(
                f"the box has {len(self.low)} lower and {len(self.high)} upper edges; give one pair per axis"
            )
        for axis, (a, b) in enumerate(zip(self.low, self.high, strict=True)):
            if not (math.isfinite(a) and math.isfinite(b) and a < b):
                raise ValueError(f"axis {axis} of the box is [{a:g}, {b:g}]; low must be finite and below high")
        if self.resolution < 2:
            raise ValueError(f"resolution is {self.resolution}; a lattice needs at least 2 nodes per axis")
        if self.size > MAX_NODES:
            raise ValueError(f"{self.resolution}^{self.dimension} nodes exceed {MAX_NODES}: lower the resolution")

    @property
    def dimension(self) -> int:
        """Number of axes p."""
        return len(self.low)

    @property
    def size(self) -> int:
        """Number of nodes m."""
        return int(self.resolution**self.dimension)

    @property
    def spacing(self) -> tuple[float, ...]:
        """Distance of neighbouring nodes, per axis."""
        return tuple((b - a) / (self.resolution - 1) for a, b in zip(self.low, self.high, strict=True))

    def half_diagonal(self, axes: Floats | None = None) -> float:
        """Return the largest distance of a point of the box from its nearest node, in the length scales if given."""
        return math.hypot(*scaled(np.array(self.spacing), axes).tolist()) / 2

    def subnode(self, z: Floats) -> tuple[float, ...]:
        """Return the point nearest to `z` (p,) on the lattice with `PARTS` times as many intervals per axis.

        Points between nodes are taken from it: a campaign that returns to a place then returns to the same point, and
        its observations merge.
        """
        low, step = np.array(self.low), np.array(self.spacing) / PARTS
        point = low + np.rint((z - low) / step) * step
        # low + k step may round to more than the upper edge.
        return tuple(np.clip(point, low, self.high).tolist())

    def kernel_rows(self, kernel: Callable[[Floats], Floats], axes: Floats | None = None) -> "KernelRows":
        """Return k(z_i, all nodes) by index; the kernel is evaluated here, once per distinct index offset.

        `axes` are the length scales of the parameters, where the kernel takes scaled distances.
        """
        return KernelRows(self, kernel, axes)


class KernelRows:
    """Kernel rows of a lattice, each taken from one table.

    A stationary kernel depends on two nodes only through |index offset| per axis, so that the table has as many numbers
    as there are nodes, and k(z_i, z_j) = k(z_j, z_i) bit by bit.
    """

    def __init__(self, lattice: Lattice, kernel: Callable[[Floats], Floats], axes: Floats | None = None) -> None:
        self.size = lattice.size
        self._shape = (lattice.resolution,) * lattice.dimension
        spacing = scaled(np.array(lattice.spacing), axes).tolist()
        self._table = kernel(_offset_distances(spacing, lattice.resolution))

    def row(self, index: int) -> Floats:
        """Return k(z_index, all nodes), shape (m,).

        Raises:
            IndexError: no node has this index.

        """
        check_index(index, self.size)
        # Offsets of both signs would make slices of the rows, and a table of 2^p times the size.
        found, steps = self._table, np.arange(self._shape[0])
        for axis, place in enumerate(np.unravel_index(index, self._shape)):
            found = found.take(np.abs(steps - place), axis=axis)
        return found.ravel()


def check_index(index: int, size: int) -> None:
    """Raise IndexError if `index` is not one of `size` candidates."""
    # Python would read a negative index from the end: another candidate than the one that was meant.
    if not 0 <= index < size:
        raise IndexError(f"candidate {index} is outside the {size} candidates")


def _offset_distances(spacing: Sequence[float], resolution: int) -> Floats:
    """Distance by non-negative index offset, shape (resolution,) * p."""
    offsets = np.arange(resolution)
    squares = [(offsets * step) ** 2 for step in spacing]
    return np.asarray(np.sqrt(sum(np.ix_(*squares))), dtype=np.float64)
