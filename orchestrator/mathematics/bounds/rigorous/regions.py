"""Regions of a band: boxes of D in which the confidence set proves the sign of the objective at every point.

| symbol | name           | meaning                                                           | shape   | unit   |
|--------|----------------|-------------------------------------------------------------------|---------|--------|
| J      |                | maximised objective, here minus the robustness or minus E[X]      |         | unit J |
| C      | `envelope`     | the confidence set after the last observation, and its band       |         |        |
| U      | `upper`        | running minimum of the certified maxima of J over D               | ()      | unit J |
| t      | `unsafe_above` | J > t at a start is unsafe; infinite where J proves no such thing | ()      | unit J |
|        | `margin`       | distance to 0 and to t that a proof has to keep                   | ()      | unit J |
| N, p   |                | number of boxes, of parameters                                    | ()      | -      |
|        | `low`, `high`  | corners of the boxes                                              | (N, p)  | parameter |
|        | `status`       | index into `STATUSES`                                             | (N,)    | -      |
|        | `share`        | volume of the boxes as a share of D, a power of 1/2 each          | (N,)    | -      |

A box is certified safe if J < 0 at every point of it for *every* function in C, and certified unsafe if J > t is. So
one event, "J - m0 is in C_n for all n", of probability 1 - delta, makes all boxes true at once, and the bound U with
them: no box spends a delta of its own, and their number and their choice after the data cost nothing. Without noise
(R = 0) the event is certain given B. The rest of D is undecided: there the band contains the threshold, or no division
within the limits separated the two.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...gp.kernels import Floats, scaled
from .cells import CellGrid, Integers, bounded, chunks
from .envelope import Envelope

STATUSES = ("safe", "unsafe", "undecided")
SAFE, UNSAFE, UNDECIDED = range(3)

MARGIN = 1e-9
"""Bounds are rounded outward to it before they are compared: a value of exactly 0 then counts on no CPU."""
HALVINGS = {1: 10, 2: 16}
"""Largest number of halvings from D to a box, by dimension: 1/1024 of one range, 1/256 of each of two."""
MOST_HALVINGS = 18
"""The same from three parameters on: 1/64 of each of three."""
MAX_CELLS = 150_000
"""Cells that one division may examine; what is open then is undecided."""
MAX_CORNERS = 2**25
"""Their corners, which decide from eight parameters on."""
MAX_WORK = 1e11
"""The same in products of numbers: a cell costs the square of the number of observed points; about 10 s."""


@dataclass(frozen=True, slots=True)
class Regions:
    """Boxes that cover D without overlap; safe ones first, then unsafe and undecided ones, each kind by its corners."""

    low: Floats
    high: Floats
    status: Integers
    share: Floats

    def of(self, status: int) -> float:
        """Return the share of D with a status: exact, because every box has a power of 1/2."""
        return float(np.sum(self.share[self.status == status]))

    def at(self, points: Floats) -> Integers:
        """Return the status at points (M, p) of D, (M,); on an edge, that of the first box in the table."""
        found = [int(np.argmax(np.all((self.low <= z) & (z <= self.high), axis=1))) for z in points]
        return self.status[np.array(found, dtype=np.intp)]


@dataclass(frozen=True, slots=True)
class _Generation:
    """Boxes of one size, numbered by the integers of their lowest corner, and the axis that made them."""

    cells: Integers
    status: Integers
    sides: Integers
    axis: int


def divide(
    envelope: Envelope,
    low: Floats,
    high: Floats,
    *,
    upper: float = math.inf,
    unsafe_above: float = 0.0,
    margin: float = MARGIN,
    max_cells: int = MAX_CELLS,
) -> Regions:
    """Return the regions of D = [low, high], (p,) each, that a confidence set proves; it must not be empty.
    Implements eq. (regions) of [PB].

    Formula: safe where min(U, bound of J over the box) < -margin, unsafe where the bound of -J over the box < -t -
    margin; the bounds are those of eq. (cover), for -J from the mirrored band. D is halved across its longest side in
    length scales, breadth first, until every box is decided or as small as `HALVINGS` allows, or the next halves would
    exceed `max_cells`, which are fewer for more than 1,000 observed points or 7 parameters. Halves of one status are
    joined again.

    Assumptions: those of the confidence set.
    """
    root = np.zeros((1, len(low)), dtype=np.intp)
    # J <= U on the event that makes the band true, so U decides D without its boxes.
    if upper < -margin:
        return _regions([_Generation(root, np.array([SAFE]), np.ones(len(low), dtype=np.intp), 0)], low, high)
    affordable = min(max_cells, MAX_CORNERS >> len(low), int(MAX_WORK / max(1, len(envelope.points)) ** 2))
    closed = list(_generations(envelope, low, high, (-margin, -unsafe_above - margin), affordable))
    return _regions(_halves_joined(closed), low, high)


def covered(boxes: Regions, within: Regions, status: int) -> NDArray[np.bool_]:
    """Return whether each box of a status is inside the boxes of this status of `within`, in the order of `boxes`."""
    mine, theirs = boxes.status == status, within.status == status
    low, high = within.low[theirs], within.high[theirs]
    found = [
        float(np.sum(np.prod(np.clip(np.minimum(high, top) - np.maximum(low, bottom), 0.0, None), axis=1)))
        >= (1.0 - 1e-9) * float(np.prod(top - bottom))
        for bottom, top in zip(boxes.low[mine], boxes.high[mine], strict=True)
    ]
    return np.array(found, dtype=np.bool_)


def _generations(
    envelope: Envelope, low: Floats, high: Floats, limits: tuple[float, float], max_cells: int
) -> Iterator[_Generation]:
    """Yield the closed boxes of every generation, from D itself on."""
    cells, axis, count = np.zeros((1, len(low)), dtype=np.intp), 0, 0
    sides = np.ones(len(low), dtype=np.intp)
    last = HALVINGS.get(len(low), MOST_HALVINGS)
    for generation in range(last + 1):
        grid = CellGrid(low, (high - low) / sides, sides)
        status = _judged(envelope, cells, grid, limits)
        is_open = status == UNDECIDED
        count += len(cells)
        if generation == last or count + 2 * int(is_open.sum()) > max_cells:
            is_open[:] = False
        yield _Generation(cells[~is_open], status[~is_open], sides, axis)
        # Halves, not 2^p children: few boxes in any dimension, and volumes that are powers of 1/2, with exact sums.
        cells = np.repeat(cells[is_open], 2, axis=0)
        if not len(cells):
            return
        axis = int(np.argmax(scaled(grid.spacing, envelope.radial.axes)))
        cells[:, axis] = 2 * cells[:, axis] + np.arange(len(cells)) % 2
        sides = sides.copy()
        sides[axis] *= 2


def _judged(envelope: Envelope, cells: Integers, grid: CellGrid, limits: tuple[float, float]) -> Integers:
    """Return the status of every cell, (N,)."""
    mirrored = envelope.mirrored()
    status = np.full(len(cells), UNDECIDED)
    for chunk in chunks(cells):
        part = cells[chunk]
        upper, lower = envelope.at(grid.centres(part))
        # What the centre does not show, no bound of the whole cell can show: most cells cost their centre alone.
        for kind, band, worst, limit in ((SAFE, envelope, upper, limits[0]), (UNSAFE, mirrored, -lower, limits[1])):
            hopeful = np.flatnonzero(worst < limit)
            if len(hopeful):
                corners, rest, _ = bounded(band, part[hopeful], grid)
                # The edges of a box are rounded to doubles; the bound of the cell changes by far less than the margin.
                proven = corners.max(axis=1) + rest < limit
                status[chunk.start + hopeful[proven]] = kind
    return status


def _halves_joined(generations: list[_Generation]) -> list[_Generation]:
    """Join two halves of one box that have one status, from the smallest boxes on."""
    found: list[_Generation] = []
    while generations:
        last = generations.pop()
        if generations:
            parents = last.cells.copy()
            parents[:, last.axis] //= 2
            keys = np.column_stack([parents, last.status])
            unique, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
            whole = counts == 2
            apart = ~whole[inverse.ravel()]
            above = generations[-1]
            joined = unique[whole]
            generations[-1] = _Generation(
                np.concatenate([above.cells, joined[:, :-1]]),
                np.concatenate([above.status, joined[:, -1]]),
                above.sides,
                above.axis,
            )
            last = _Generation(last.cells[apart], last.status[apart], last.sides, last.axis)
        found.append(last)
    return found


def _regions(generations: list[_Generation], low: Floats, high: Floats) -> Regions:
    def places(cells: Integers, sides: Integers) -> Floats:
        part: NDArray[np.float64] = cells / sides  # exact: the sides are powers of two
        return low * (1.0 - part) + high * part  # exact at both ends of D

    lows = np.concatenate([places(each.cells, each.sides) for each in generations])
    highs = np.concatenate([places(each.cells + 1, each.sides) for each in generations])
    status = np.concatenate([each.status for each in generations])
    share = np.concatenate([np.full(len(each.cells), 1.0 / float(np.prod(each.sides))) for each in generations])
    order = np.lexsort([*lows.T[::-1], status])
    return Regions(lows[order], highs[order], status[order], share[order])
