"""The nearest failure: next to a passing point in every parameter that matters, the others at their nominal values."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.search.nearest import CLOSE, nearest_tests
from perfbound.orchestrator.mathematics.search.simplest import Group, Point

NOMINAL = (0.5, 0.5, 0.5)
EACH: tuple[Group, ...] = ((0,), (1,), (2,))
shares = st.floats(0, 1)


def nearest(
    point: Point, fails: Callable[[Point], bool], groups: tuple[Group, ...] = EACH, widths: Point = (1.0, 1.0, 1.0)
) -> tuple[Point, int]:
    """Return what the tests end with, and how many they are."""
    tests, number = nearest_tests(point, NOMINAL, groups, widths), 0
    tested = next(tests)
    while True:
        number += 1
        try:
            tested = tests.send(fails(tested))
        except StopIteration as end:
            found: Point = end.value
            return found, number


@given(st.tuples(shares, shares, shares), st.tuples(*[st.floats(-1, 1)] * 3), st.floats(-1, 1))
def test_the_end_fails_and_each_moved_parameter_is_next_to_what_passes(
    point: Point, weights: Point, level: float
) -> None:
    def fails(tried: Point) -> bool:
        return sum(w * value for w, value in zip(weights, tried, strict=True)) >= level

    if not fails(point) or point == NOMINAL:
        return
    found, number = nearest(point, fails)
    assert fails(found)
    assert number < 60
    for k, (value, nominal, before) in enumerate(zip(found, NOMINAL, point, strict=True)):
        assert min(nominal, before) <= value <= max(nominal, before)
        if value != nominal:
            nearer = (
                nominal if abs(value - nominal) <= 2 * CLOSE else value + 2 * CLOSE * (1 if nominal > value else -1)
            )
            assert not fails((*found[:k], nearer, *found[k + 1 :]))


def test_a_border_in_one_parameter_is_found_to_a_hundredth_of_its_range_and_the_others_are_nominal() -> None:
    found, number = nearest((0.9, 0.1, 0.0), lambda tried: tried[0] >= 0.7)
    assert found[1:] == (0.5, 0.5)
    assert 0.7 <= found[0] <= 0.7 + CLOSE
    assert number < 20


def test_two_parameters_that_have_to_be_large_together_both_move() -> None:
    found, _ = nearest((1.0, 1.0, 0.2), lambda tried: tried[0] + tried[1] >= 1.7)
    assert found[2] == 0.5
    assert 1.7 <= found[0] + found[1] <= 1.7 + 2 * CLOSE


def test_what_is_in_no_group_stays_as_it_is_and_widths_are_units() -> None:
    found, number = nearest((0.9, 0.1, 0.0), lambda tried: tried[0] >= 0.7 and tried[2] == 0, groups=((0,), (1,)))
    assert found[1:] == (0.5, 0.0)
    wide, fewer = nearest((0.9, 0.1, 0.0), lambda tried: tried[0] >= 0.7, widths=(10.0, 1.0, 1.0))
    assert wide[0] >= 0.7
    assert fewer < number


@pytest.mark.parametrize("fails", [True, False])
def test_a_nominal_point_that_fails_is_the_end_and_nothing_else_that_fails_leaves_the_point(fails: bool) -> None:
    found, number = nearest((0.9, 0.1, 0.3), lambda _: fails)
    if fails:
        assert (found, number) == (NOMINAL, 1)
    else:
        assert found == (0.9, 0.1, 0.3)
