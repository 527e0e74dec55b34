"""Groups of starts that are near each other: single linkage in the box of the starts, scaled to the unit cube."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..data.rollouts import StartGroup, ViolatingStart, ViolatingStarts

NEAR = 0.1
"""Two starts are near if they differ by at most this share of its range in each parameter."""
ROUND_OFF = 1e-9
"""Starts of a lattice that are exactly this far apart are near, too."""
MOST_STARTS = 1000
"""Starts in groups, the worst ones: the cost grows with their square."""


def grouped(starts: Sequence[ViolatingStart], ranges: Sequence[tuple[float, float]]) -> ViolatingStarts:
    """Return the starts in groups, those with the worst rollouts first; of more than `MOST_STARTS` the others counted.

    Each start of a group is near another one of it, and no two groups have starts that are near each other.

    >>> starts = [ViolatingStart((x,), 1, 2, -x, "p", k) for k, x in enumerate((0.1, 0.15, 0.9))]
    >>> [(group.low, group.high, group.violations, group.rollouts) for group in grouped(starts, [(0.0, 1.0)]).groups]
    [((0.9,), (0.9,), 1, 2), ((0.1,), (0.15,), 2, 4)]
    """
    worst_first = sorted(starts, key=lambda start: (start.worst, start.x))
    kept, others = worst_first[:MOST_STARTS], worst_first[MOST_STARTS:]
    groups: dict[int, list[ViolatingStart]] = {}
    # Single linkage: nothing to choose, and no random start, as k-means and DBSCAN have.
    for start, number in zip(kept, _linked(_scaled(kept, ranges)), strict=True):
        groups.setdefault(number, []).append(start)
    return ViolatingStarts(
        groups=tuple(map(_group, groups.values())),
        starts=len(starts),
        near=NEAR,
        other_starts=len(others),
        other_violations=sum(start.violations for start in others),
        other_rollouts=sum(start.rollouts for start in others),
    )


def _scaled(starts: Sequence[ViolatingStart], ranges: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Return the starts (n, p) in the unit cube; a parameter of one value is 0."""
    low, high = np.array(ranges, dtype=np.float64).reshape(-1, 2).T
    width = np.where(high > low, high - low, np.inf)
    points = np.array([start.x for start in starts], dtype=np.float64).reshape(len(starts), len(low))
    scaled: NDArray[np.float64] = (points - low) / width
    return scaled


def _linked(points: NDArray[np.float64]) -> list[int]:
    """Return a number for each of the points (n, p), equal for those that a chain of near ones joins."""
    number = np.full(len(points), -1)
    for first in range(len(points)):
        reached = [first] if number[first] < 0 else []
        number[reached] = first
        while reached:
            distance = np.abs(points - points[reached.pop()]).max(axis=1, initial=0.0)
            new = np.flatnonzero((number < 0) & (distance <= NEAR + ROUND_OFF))
            number[new] = first
            reached += new.tolist()
    found: list[int] = number.tolist()
    return found


def _group(starts: Sequence[ViolatingStart]) -> StartGroup:
    columns = list(zip(*(start.x for start in starts), strict=True))
    return StartGroup(
        low=tuple(map(min, columns)),
        high=tuple(map(max, columns)),
        starts=tuple(starts),
        violations=sum(start.violations for start in starts),
        rollouts=sum(start.rollouts for start in starts),
        worst=starts[0].worst,
    )
