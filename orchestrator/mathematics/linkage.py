"""Groups of points that are near each other, by single linkage: there is nothing to choose, and no chance."""

import numpy as np

from .gp.kernels import Floats

NEAR = 0.1
"""Two points of the unit cube are near if they differ by at most this in each coordinate."""
ROUND_OFF = 1e-9
"""Points of a lattice that are exactly this far apart are near, too."""


def unit_points(points: Floats, low: Floats, high: Floats) -> Floats:
    """Return points (n, p) of a box in the unit cube; a coordinate of one value is 0."""
    found: Floats = (points - low) / np.where(high > low, high - low, np.inf)
    return found


def linked(points: Floats) -> list[int]:
    """Return a number for each of the points (n, p), equal for those that a chain of near ones joins.

    >>> linked(np.array([[0.1], [0.9], [0.15]]))
    [0, 1, 0]
    """
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
