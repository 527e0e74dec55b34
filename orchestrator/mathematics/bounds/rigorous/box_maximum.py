"""Certified maximum over a box: branch and bound over the cells between the nodes.

| symbol | name       | meaning                                                           | shape  | unit   |
|--------|------------|-------------------------------------------------------------------|--------|--------|
| U(z)   |            | upper bound of the objective at z: the sum of the bands           |        | unit J |
|        | `nodes`    | max of U over the nodes of the lattice                            | ()     | unit J |
| h      | `half`     | half side lengths of the cells of one generation                  | (p,)   | m      |
|        | `slack`    | allowed excess of the certified maximum over the best U(z) found  | ()     | unit J |
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...gp.kernels import Floats
from ...gp.lattice import Lattice
from .cells import CellGrid, Integers, bounded, chunks
from .envelope import Envelope

MAX_CELLS = 20_000
"""Cells of the box that one observation may cost; beyond it the bound is valid but less tight than `slack`."""
MAX_CORNERS = 2**23
"""Their corners, which decide from nine parameters on: a cell of twelve has 4,096."""


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
    its parent. After `max_cells` cells, or `MAX_CORNERS` corners, it stops: the bound remains valid, only its distance
    to the best U(z) found may exceed `slack`. Deterministic: breadth first, in the order of the lattice.
    """
    sides = lattice.resolution - 1
    cells = np.stack(np.unravel_index(np.arange(sides**lattice.dimension), (sides,) * lattice.dimension), axis=1)
    grid = CellGrid(np.array(lattice.low), np.array(lattice.spacing), np.full(lattice.dimension, sides))
    offsets = grid.offsets
    affordable = min(max_cells, MAX_CORNERS >> lattice.dimension)
    parents, best, closed, count = np.full(len(cells), np.inf), nodes, -np.inf, 0
    while len(cells):
        bounds, found = _over(envelopes, cells, grid)
        # A child is a part of its parent, so the parent's bound is valid for it too.
        bounds, best, count = np.minimum(bounds, parents), max(best, found), count + len(cells)
        # The other cells cannot raise the result by more than `slack`: they are closed with their bounds.
        split = bounds > best + slack
        if count + len(offsets) * int(split.sum()) > affordable:
            split[:] = False  # out of budget: every open cell is closed with its bound
        closed = max(closed, float(np.max(bounds, where=~split, initial=-np.inf)))
        cells = (2 * cells[split][:, None, :] + offsets).reshape(-1, lattice.dimension)
        parents = np.repeat(bounds[split], len(offsets))
        grid = CellGrid(grid.low, grid.spacing / 2.0, 2 * grid.sides)
    return Cover(max(closed, best), best, count)


def _over(envelopes: Sequence[Envelope], cells: Integers, grid: CellGrid) -> tuple[Floats, float]:
    """Return a bound for every cell (N,), and the largest value of the sum that was found at one point."""
    bounds, found = np.empty(len(cells)), -np.inf
    for chunk in chunks(cells):
        part = cells[chunk]
        corners, rest, values = (np.zeros(shape) for shape in ((len(part), len(grid.offsets)), len(part), len(part)))
        for envelope in envelopes:
            one, remainder, at = bounded(envelope, part, grid)
            corners, rest, values = corners + one, rest + remainder, values + at
        bounds[chunk] = corners.max(axis=1) + rest
        found = max(found, float(values.max()))
    return bounds, found
