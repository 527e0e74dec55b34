"""Certified maximum over a box: branch and bound over the cells between the nodes.

| symbol | name       | meaning                                                           | shape  | unit   |
|--------|------------|-------------------------------------------------------------------|--------|--------|
| U(z)   |            | upper bound of the objective at z: the sum of the bands           |        | unit J |
|        | `nodes`    | max of U over the nodes of the lattice                            | ()     | unit J |
| h      | `half`     | half side lengths of the cells of one generation                  | (p,)   | m      |
|        | `slack`    | allowed excess of the certified maximum over the best U(z) found  | ()     | unit J |
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..gp.kernels import Floats
from ..gp.lattice import Lattice
from .envelope import Envelope

Integers = NDArray[np.intp]

MAX_CELLS = 20_000
"""Cells of the box that one observation may cost; beyond it the bound is valid but less tight than `slack`."""
_CHUNK = 4096
"""Cells per matrix product: bounds the memory."""


@dataclass(frozen=True, slots=True)
class Cover:
    """A number that U(z) exceeds at no point of the box, the largest U(z) found, and the cells examined."""

    upper: float
    found: float
    cells: int


def certified_maximum(
    envelopes: Sequence[Envelope], lattice: Lattice, *, nodes: float, slack: float, max_cells: int = MAX_CELLS
) -> Cover:
    """Return a bound of the maximum over the box of the sum of the envelopes' upper bands.
    Implements eq. (cover) of [PB].

    Formula: branch and bound. The cells between the nodes are bounded by corner values and a rest (see
    `bounds.envelope`); those above the best U(z) found so far + `slack` are split in 2^p; a child is never worse than
    its parent. After `max_cells` cells it stops: the bound remains valid, only its distance to the best U(z) found may
    exceed `slack`. Deterministic: breadth first, in the order of the lattice.
    """
    sides = lattice.resolution - 1
    cells = np.stack(np.unravel_index(np.arange(sides**lattice.dimension), (sides,) * lattice.dimension), axis=1)
    offsets = np.array(list(product((0, 1), repeat=lattice.dimension)))  # (2^p, p)
    grid = _Grid(np.array(lattice.low), np.array(lattice.spacing), sides, offsets)
    parents, best, closed, count = np.full(len(cells), np.inf), nodes, -np.inf, 0
    while len(cells):
        bounds, found = _over(envelopes, cells, grid)
        # A child is a part of its parent, so the parent's bound is valid for it too.
        bounds, best, count = np.minimum(bounds, parents), max(best, found), count + len(cells)
        # The other cells cannot raise the result by more than `slack`: they are closed with their bounds.
        split = bounds > best + slack
        if count + len(offsets) * int(split.sum()) > max_cells:
            split[:] = False  # out of budget: every open cell is closed with its bound
        closed = max(closed, float(np.max(bounds, where=~split, initial=-np.inf)))
        cells = (2 * cells[split][:, None, :] + offsets).reshape(-1, lattice.dimension)
        parents = np.repeat(bounds[split], len(offsets))
        grid = replace(grid, spacing=grid.spacing / 2.0, sides=2 * grid.sides)
    return Cover(max(closed, best), best, count)


@dataclass(frozen=True, slots=True)
class _Grid:
    """Cells of one generation, numbered by the integers of their lowest corner."""

    low: Floats
    spacing: Floats
    sides: int
    offsets: Integers

    def centres(self, cells: Integers) -> Floats:
        return np.asarray(self.low + self.spacing * (cells + 0.5), dtype=np.float64)

    def corners(self, cells: Integers) -> tuple[Floats, Integers]:
        """Return the distinct corners (C, p) of the cells, and the numbers of those of each cell (N, 2^p)."""
        shape = (self.sides + 1,) * cells.shape[1]
        corners = (cells[:, None, :] + self.offsets).reshape(-1, cells.shape[1])
        # Neighbouring cells share corners, and a corner costs a product with all observed points.
        keys, inverse = np.unique(np.ravel_multi_index(tuple(corners.T), shape), return_inverse=True)
        places = np.stack(np.unravel_index(keys, shape), axis=1)
        return self.low + self.spacing * places, inverse.reshape(len(cells), -1)


def _over(envelopes: Sequence[Envelope], cells: Integers, grid: _Grid) -> tuple[Floats, float]:
    """Return a bound for every cell (N,), and the largest value of the sum that was found at one point."""
    bounds, found = np.empty(len(cells)), -np.inf
    for start in range(0, len(cells), _CHUNK):
        part = cells[start : start + _CHUNK]
        corners, rest, values = (np.zeros(shape) for shape in ((len(part), len(grid.offsets)), len(part), len(part)))
        for envelope in envelopes:
            one, remainder, at = _bounded(envelope, part, grid)
            corners, rest, values = corners + one, rest + remainder, values + at
        bounds[start : start + _CHUNK] = corners.max(axis=1) + rest
        found = max(found, float(values.max()))
    return bounds, found


def _bounded(envelope: Envelope, cells: Integers, grid: _Grid) -> tuple[Floats, Floats | float, Floats]:
    """Return (corner values, rest, upper value at the centres) of one envelope."""
    centres, half = grid.centres(cells), grid.spacing / 2.0
    # nu <= 2: a function of the ball need not have a second derivative, but the edge of the band has a bound.
    if not np.isfinite(envelope.radial.bend):
        return envelope.over(centres, half, np.where(grid.offsets > 0, 1.0, -1.0))
    points, inverse = grid.corners(cells)
    return envelope.at(points)[0][inverse], envelope.rest(half), envelope.at(centres)[0]
