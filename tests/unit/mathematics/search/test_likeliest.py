"""The likeliest failure on functions whose design point is known."""

import math
import random
from collections.abc import Callable

import pytest

from perfbound.orchestrator.mathematics.search import Falsifier
from perfbound.orchestrator.mathematics.search.likeliest import Likeliest, Point

Margin = Callable[[Point], float]
LOW, HIGH = (0.0, -5.0, -5.0, -5.0), (1.0, 5.0, 5.0, 5.0)


def corner(x: Point) -> float:
    return max(0.8 - x[0], 2.2 - x[1], 2.0 - x[2])


def plane(x: Point) -> float:
    return 4.0 - x[1] - x[2] + 2.0 * (1.0 - x[0])


def ball(x: Point) -> float:
    return 0.1 * ((x[1] - 4.0) ** 2 + (x[2] - 3.5) ** 2 - 5.0) + 2.0 * max(0.0, 0.8 - x[0])


def sought(margin: Margin, start: Point) -> tuple[Likeliest, list[Point]]:
    found = Likeliest(start, margin(start), LOW, HIGH, scored=(1, 2, 3))
    tests = found.tests()
    tried: list[Point] = []
    point = next(tests)
    while len(tried) < 100:
        tried.append(point)
        try:
            point = tests.send((point, margin(point)))
        except StopIteration:
            break
    return found, tried


@pytest.mark.parametrize(
    ("margin", "exact"),
    [(corner, math.hypot(2.2, 2.0)), (plane, math.sqrt(8.0)), (ball, math.hypot(4.0, 3.5) - math.sqrt(5.0))],
)
def test_it_is_within_a_tenth_of_the_design_point(margin: Margin, exact: float) -> None:
    rng = random.Random(3)
    for _ in range(5):
        start = next(x for x in iter(lambda: tuple(map(rng.uniform, LOW, HIGH)), None) if margin(x) < 0)
        found, tried = sought(margin, start)
        assert margin(found.best) < 0
        assert exact <= found.distance <= exact + 0.1
        assert all(low <= each <= high for x in tried for low, each, high in zip(LOW, x, HIGH, strict=True))
        assert sought(margin, start)[1] == tried, "each test follows from those before it"


def test_where_the_medians_fail_the_distance_is_0() -> None:
    found, _ = sought(lambda x: x[1] - 4.0, (0.5, 3.0, 3.0, 3.0))
    assert found.distance < 0.2


@pytest.mark.rest
def test_a_search_over_disturbances_needs_half_as_many_tests_at_most() -> None:
    """Over starts, a test at the worst of them fails with the probability P(t1 > 2.2) P(t2 > 2)."""
    share = math.erfc(2.2 / math.sqrt(2.0)) / 2 * math.erfc(2.0 / math.sqrt(2.0)) / 2
    least = math.log(2.0) / share  # median, if every test was at such a start
    needed = []
    for seed in range(21):
        search = Falsifier(LOW, HIGH, seed=seed)
        while corner(x := search.propose()) >= 0 and search.observations < least:
            search.observe(x, corner(x))
        needed.append(search.observations + 1)
    assert sorted(needed)[10] <= least / 2
