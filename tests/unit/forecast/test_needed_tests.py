"""Forecasts of the tests that a bound needs: on courses of known form, and of drawn starts."""

import math
from collections.abc import Callable

import pytest
from scipy.stats import binom

from perfbound.orchestrator.forecast.needed_tests import FOR_A_FORECAST, FURTHEST, needed_samples, needed_tests
from perfbound.schemas.values import MARKED, Bound, ProblemProgress

Course = Callable[[int], float]


def progress(course: Course, tests: int, lower: float | None = None) -> ProblemProgress:
    """Return a problem after so many tests whose bounds have followed a course."""
    points = tuple((at, course(at), None) for at in sorted(MARKED) if at < tests)
    return ProblemProgress(tests, 4 * tests, None, Bound(course(tests), lower, None), "budget", None, points)


@pytest.mark.parametrize(
    "course",
    [
        lambda n: 5.0 + 40.0 / n,
        lambda n: 5.0 + 30.0 / math.sqrt(n),
        lambda n: 20.0 - 3.0 * math.log(n),
        lambda n: 5.0 + 60.0 / n**0.7,
    ],
    ids=["1/n", "root", "log", "between"],
)
@pytest.mark.parametrize("times", [1.3, 2.0, 4.0])
def test_the_range_contains_the_number_of_a_course_of_known_form(course: Course, times: float) -> None:
    tests = 60
    wanted = round(times * tests)
    found = needed_tests(progress(course, tests), course(wanted))
    assert found is not None
    assert found.low is not None
    assert 0 < found.low <= 1.06 * (wanted - tests) + 1
    assert found.high is None or found.high >= wanted - tests


def test_a_limit_that_the_course_approaches_from_above_is_never_reached() -> None:
    found = needed_tests(progress(lambda n: 5.0 + 40.0 / n, 60), 4.9)
    assert found is not None
    assert (found.probable, found.high) == (None, None)
    falling = needed_tests(progress(lambda n: 20.0 - 0.01 * math.log(n), 60), 20.0 - 0.01 * math.log(61 * FURTHEST))
    assert falling is not None
    assert falling.low is None, "too far away to be forecast"


def test_the_bound_from_the_other_side_is_never_passed() -> None:
    course: Course = lambda n: 20.0 - 3.0 * math.log(n)  # noqa: E731
    free, held = (needed_tests(progress(course, 60, lower), 7.0) for lower in (None, 7.5))
    assert free is not None
    assert held is not None
    assert free.low is not None
    assert held.low is None


def test_few_tests_give_no_forecast() -> None:
    course: Course = lambda n: 5.0 + 40.0 / n  # noqa: E731
    assert needed_tests(progress(course, 8), 6.0) is None
    assert needed_tests(progress(course, FOR_A_FORECAST), 6.0) is not None
    assert needed_tests(ProblemProgress(0, 0, None, None, None), 1.0) is None


@pytest.mark.parametrize(
    ("samples", "violations", "limit"), [(50, 0, 0.01), (299, 0, 0.001), (400, 2, 0.01), (90, 9, 0.2)]
)
def test_the_drawn_starts_are_enough_and_hardly_fewer_are(samples: int, violations: int, limit: float) -> None:
    found = needed_samples(samples, violations, limit, 0.05)
    assert found is not None
    fewer = int(0.8 * found)
    assert binom.cdf(math.ceil(violations / samples * found), found, limit) <= 0.05
    assert binom.cdf(math.ceil(violations / samples * fewer), fewer, limit) > 0.05


def test_a_share_that_is_too_large_is_never_enough() -> None:
    assert needed_samples(100, 5, 0.05, 0.05) is None
    assert needed_samples(100, 5, 0.01, 0.05) is None
    assert needed_samples(100, 49, 0.4900001, 0.05) is None
    assert needed_samples(100, 0, 1.0, 0.05) is None
