"""How many tests a bound would probably need to reach a limit: the forecast of `outlook`, asked the other way round."""

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ...schemas.values import Guess, ProblemProgress
from .outlook import FEWEST_POINTS, outlook, with_last
from .remaining import FEWEST

FURTHEST = 30
"""Times as many tests as there were: a course says nothing about what is further away."""
STEP = 1.04
"""Ratio of two numbers of tests that are tried."""
SLOWER = 2
"""Times the slowest fit: of 369 forecasts after 20 to 250 tests it was enough in 261, and twice as much in 346."""
LEAST_MORE = 0.25
"""Of the tests so far, the fewest that are worth an extension: the bound falls in steps."""
FOR_A_FORECAST = 2 * FEWEST
"""Tests of a course that is long enough for a forecast: `FEWEST_POINTS` of them are marked."""


@dataclass(frozen=True, slots=True)
class NeededTests:
    """How many tests more a bound needs to reach a limit, each None where that is further than `FURTHEST`."""

    low: int | None
    """By the middle one of the fits of the course, which is early: a bound falls more slowly than it did."""
    probable: int | None
    """By the fit that falls slowest."""
    high: int | None
    """What is enough almost always."""


def needed_tests(progress: ProblemProgress, limit: float) -> NeededTests | None:
    """Return how many more tests would bring the bound on J of a problem to `limit`; None without a forecast."""
    if progress.bound is None or progress.bound.upper is None or not progress.tests:
        return None
    numbers = [math.ceil(progress.tests * STEP**power) for power in range(1, _POWERS)]
    ahead = partial(
        outlook, with_last(progress), least=progress.bound.lower, per_test=progress.rollouts / progress.tests
    )
    if ahead(most=numbers[0]) is None:
        return None

    def after(number: int) -> Guess:
        found = ahead(most=number)
        assert found is not None, "whether there is a forecast does not depend on its number"
        return found.at_budget

    def first(end: Callable[[Guess], float]) -> int | None:
        # The forecast falls with the number of tests.
        place = bisect_left(numbers, True, key=lambda number: end(after(number)) <= limit)
        return numbers[place] - progress.tests if place < len(numbers) else None

    slowest = first(lambda guess: guess.high)
    high = None if slowest is None else max(SLOWER * slowest, math.ceil(LEAST_MORE * progress.tests))
    return NeededTests(first(lambda guess: guess.middle), slowest, high)


def needed_samples(samples: int, violations: int, limit: float, delta: float) -> int | None:
    """Return the drawn starts that would show a failure probability of at most `limit`, with confidence 1 - delta.

    The share of violations stays what it was among `samples` starts; None where that is not below the limit, or where
    more than `FURTHEST` times as many starts would be needed. By the tail of the binomial distribution.

    >>> needed_samples(50, 0, 0.01, 0.05)
    299
    """
    share = violations / samples

    def is_enough(number: int) -> bool:
        return _at_most(math.ceil(share * number), number, limit) <= delta

    most = FURTHEST * max(samples, math.ceil(math.log(delta) / math.log1p(-limit)) if 0.0 < limit < 1.0 else 0)
    if not share < limit < 1.0 or not is_enough(most):
        return None
    return bisect_left(range(most), True, key=is_enough)


def _at_most(count: int, number: int, share: float) -> float:
    """Return the probability of at most `count` successes among `number`, each with probability `share`."""
    logs = (
        math.lgamma(number + 1)
        - math.lgamma(each + 1)
        - math.lgamma(number - each + 1)
        + each * math.log(share)
        + (number - each) * math.log1p(-share)
        for each in range(count + 1)
    )
    return math.fsum(math.exp(each) for each in logs)


_POWERS = math.ceil(math.log(FURTHEST) / math.log(STEP)) + 1
assert FOR_A_FORECAST >= FEWEST + FEWEST_POINTS
