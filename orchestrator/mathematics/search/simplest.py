"""The simplest failure: from a failing point towards one with as many parameters as possible at their nominal value.

Groups of parameters are set back together: all of them, halves, quarters and so on down to one, where the rounds are
repeated until none changes anything. What is set back stays so as long as the system fails. This is the method of
Zeller and Hildebrandt (delta debugging) without its complements: k of n groups that matter take about 2 k log2(n) tests
and not n. A group that is left is tried by its parameters.
"""

from collections.abc import Generator, Iterator, Sequence

Point = tuple[float, ...]
Group = tuple[int, ...]
"""Numbers of parameters, as of the knots of one input over time."""
Tests = Generator[Point, bool, Point]
"""Yields the next test, is sent whether it fails, and returns the last one that does."""


def simplest_tests(point: Point, nominal: Point, groups: Sequence[Group]) -> Tests:
    """Yield the tests from a failing point on; every parameter is in one of the groups.

    >>> tests = simplest_tests((1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0), [(0,), (1,), (2, 3)])
    >>> next(tests)
    (0.0, 0.0, 0.0, 0.0)
    >>> tests.send(False)  # one of the three groups
    (0.0, 1.0, 1.0, 1.0)
    """
    passed: set[Point] = set()
    point = yield from _set_back(point, nominal, groups, passed)
    return (yield from _set_back(point, nominal, [(each,) for group in groups for each in group], passed))


def away(point: Point, nominal: Point) -> tuple[int, ...]:
    """Return the numbers of the parameters that are not at their nominal value.

    >>> away((1.0, 0.0, 2.0), (1.0, 1.0, 1.0))
    (1, 2)
    """
    return tuple(number for number, pair in enumerate(zip(point, nominal, strict=True)) if pair[0] != pair[1])


def _set_back(point: Point, nominal: Point, groups: Sequence[Group], passed: set[Point]) -> Tests:
    """Set back the groups; `passed` are the points that are known to pass."""
    size = len(groups)
    while size:
        before = point
        left = [group for group in groups if not set(group).isdisjoint(away(point, nominal))]
        for some in _parts(left, size):
            tried = tuple(nominal[k] if k in some else value for k, value in enumerate(point))
            if tried in passed:
                continue
            if (yield tried):
                point = tried
            else:
                passed.add(tried)
        if size == 1 and point == before:
            break
        size = max(min(size, len(left)) // 2, 1)
    return point


def _parts(groups: Sequence[Group], size: int) -> Iterator[frozenset[int]]:
    """Yield the parameters of so many groups after another."""
    for first in range(0, len(groups), size):
        yield frozenset(number for group in groups[first : first + size] for number in group)
