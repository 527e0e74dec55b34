"""The nearest failure: from a failing point to one that is next to a passing one, in every parameter that matters.

As many parameters as possible take their nominal value; the others move towards it, first together and then one after
the other, the one that is furthest away first. Each end is found by halving the way to what passes. What fails at a
place and passes nearer to it and fails again is no obstacle: the border that is found is one of several.
"""

from collections.abc import Sequence

from .simplest import Group, Point, Tests, away, simplest_tests

CLOSE = 1 / 256
"""How near to a passing point the failing one is, as a share of the range of each parameter."""


def nearest_tests(point: Point, nominal: Point, groups: Sequence[Group], widths: Sequence[float]) -> Tests:
    """Yield the tests from a failing point on; `widths` (n,) are the ranges. The other parameters stay as they are.

    >>> tests = nearest_tests((1.0, 1.0), (0.0, 0.0), [(0,), (1,)], (1.0, 1.0))
    >>> test = next(tests)
    >>> try:
    ...     while True:
    ...         test = tests.send(test[0] > 0.3)
    ... except StopIteration as end:
    ...     [round(value, 2) for value in end.value]
    [0.3, 0.0]
    """
    point = yield from simplest_tests(point, nominal, groups)
    moved = [k for k in away(point, nominal) if any(k in group for group in groups)]
    if len(moved) > 1:
        point = yield from _halved(point, nominal, moved, widths)
    for k in sorted(moved, key=lambda k: -abs(point[k] - nominal[k]) / widths[k]):
        point = yield from _halved(point, nominal, [k], widths)
    return point


def _halved(point: Point, nominal: Point, moved: Sequence[int], widths: Sequence[float]) -> Tests:
    """Move some parameters towards their nominal values, to the last failing point before one that passes."""
    start, failing, passing = point, 1.0, 0.0
    length = max(abs(start[k] - nominal[k]) / widths[k] for k in moved)
    share = 0.0  # the end first: there it may fail, since others have moved
    while (failing - passing) * length > CLOSE:
        tried = tuple(
            nominal[k] + share * (value - nominal[k]) if k in moved else value for k, value in enumerate(start)
        )
        if (yield tried):
            point, failing = tried, share
        else:
            passing = share
        share = (failing + passing) / 2
    return point
