"""Groups of starts that are near each other: single linkage in the box of the starts, scaled to the unit cube."""

from collections.abc import Sequence

import numpy as np

from ...mathematics.linkage import NEAR, linked, unit_points
from ..data.rollouts import StartGroup, ViolatingStart, ViolatingStarts

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
    low, high = np.array(ranges, dtype=np.float64).reshape(-1, 2).T
    points = np.array([start.x for start in kept], dtype=np.float64).reshape(len(kept), len(low))
    for start, number in zip(kept, linked(unit_points(points, low, high)), strict=True):
        groups.setdefault(number, []).append(start)
    return ViolatingStarts(
        groups=tuple(map(_group, groups.values())),
        starts=len(starts),
        near=NEAR,
        other_starts=len(others),
        other_violations=sum(start.violations for start in others),
        other_rollouts=sum(start.rollouts for start in others),
    )


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
