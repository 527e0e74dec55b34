"""Cells of one size over a box, and the bound of a band over each of them.

| symbol | name      | meaning                                                  | shape  | unit |
|--------|-----------|----------------------------------------------------------|--------|------|
| p      |           | number of parameters                                     | ()     | -    |
|        | `cells`   | integers of the lowest corner of each cell               | (N, p) | -    |
|        | `spacing` | side lengths of the cells                                | (p,)   | m    |
|        | `sides`   | number of cells along each side of the box               | (p,)   | -    |
|        | `offsets` | 0 or 1 for every axis: the corners of a cell             | (2^p, p) | -  |
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...blocks import blocks
from ...gp.kernels import Floats
from .envelope import Envelope

Integers = NDArray[np.intp]

CHUNK = 4096
"""Cells that are bounded together: bounds the memory."""
MOST_CORNERS = 2**20
"""Corners of these, each counted for every cell that has it: of more than eight parameters the cells are fewer."""


def chunks(cells: Integers) -> Iterator[slice]:
    """Yield the slices of the cells (N, p) that are bounded together."""
    size = max(1, min(CHUNK, MOST_CORNERS >> cells.shape[1]))
    return (slice(start, start + size) for start in range(0, len(cells), size))


@dataclass(frozen=True)
class CellGrid:
    """Cells of one generation, numbered by the integers of their lowest corner."""

    low: Floats
    spacing: Floats
    sides: Integers

    @cached_property
    def offsets(self) -> Integers:
        """Corners of a cell, as 0 or 1 for every axis, (2^p, p)."""
        return np.array(list(product((0, 1), repeat=len(self.low))))

    def centres(self, cells: Integers) -> Floats:
        """Return the centres of the cells, (N, p)."""
        return np.asarray(self.low + self.spacing * (cells + 0.5), dtype=np.float64)

    def corners(self, cells: Integers) -> tuple[Floats, Integers]:
        """Return the distinct corners (C, p) of the cells, and the numbers of those of each cell (N, 2^p)."""
        shape = tuple((self.sides + 1).tolist())
        corners = (cells[:, None, :] + self.offsets).reshape(-1, cells.shape[1])
        # Neighbouring cells share corners, and a corner costs a product with all observed points.
        keys, inverse = np.unique(np.ravel_multi_index(tuple(corners.T), shape), return_inverse=True)
        places = np.stack(np.unravel_index(keys, shape), axis=1)
        return self.low + self.spacing * places, inverse.reshape(len(cells), -1)


def bounded(envelope: Envelope, cells: Integers, grid: CellGrid) -> tuple[Floats, Floats | float, Floats]:
    """Return (corner values (N, 2^p), rest, upper value at the centres (N,)) of one envelope, unit J.

    No J of the confidence set exceeds the largest corner value of a cell plus the rest at any point of the cell.
    """
    centres, half = grid.centres(cells), grid.spacing / 2.0
    # nu <= 2: a function of the ball need not have a second derivative, but the edge of the band has a bound.
    if not np.isfinite(envelope.radial.bend):
        signs = np.where(grid.offsets > 0, 1.0, -1.0)
        parts = [envelope.over(centres[part], half, signs) for part in blocks(len(cells), envelope.points.size)]
        corners, rest, values = (np.concatenate(each) for each in zip(*parts, strict=True))
        return corners, rest, values
    points, inverse = grid.corners(cells)
    return envelope.at(points)[0][inverse], envelope.rest(half), envelope.at(centres)[0]
