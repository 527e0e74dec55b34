"""The simplest failure: as many parameters as possible at their nominal value, in few tests, inputs first."""

from collections.abc import Callable, Sequence

import pytest

from perfbound.orchestrator.mathematics.search.simplest import Group, Point, simplest_tests


def simplified(
    point: Point, groups: Sequence[Group], fails: Callable[[Point], bool], most: int = 1000
) -> tuple[Point, list[Point]]:
    """Return the simplest failing point with the nominal values 0, and all tests."""
    tests, tried, best = simplest_tests(point, (0.0,) * len(point), groups), list[Point](), point
    tested = next(tests, None)
    while tested is not None and len(tried) < most:
        tried.append(tested)
        if fails(tested):
            best = tested
        try:
            tested = tests.send(fails(tested))
        except StopIteration:
            break
    return best, tried


def alone(number: int) -> list[Group]:
    return [(each,) for each in range(number)]


@pytest.mark.parametrize("matter", [(), (3,), (3, 31), (0, 1, 39)])
def test_what_matters_is_left_after_few_tests(matter: tuple[int, ...]) -> None:
    best, tried = simplified((1.0,) * 40, alone(40), lambda point: all(point[k] for k in matter))
    assert [k for k, value in enumerate(best) if value] == list(matter)
    assert len(tried) <= 1 + 12 * len(matter)
    assert len(set(tried)) == len(tried), "no test is repeated"


def test_an_input_is_set_back_as_a_whole_before_its_knots() -> None:
    inputs: list[Group] = [(0,), tuple(range(1, 11)), tuple(range(11, 21))]
    best, tried = simplified((1.0,) * 21, inputs, lambda point: point[7] > 0)
    assert [k for k, value in enumerate(best) if value] == [7]
    # All of them, then the three one by one: without the first one it still fails.
    assert [sum(each) for each in tried[:4]] == [0, 20, 10, 10]


def test_a_parameter_that_is_needed_only_while_another_one_is_there_is_tried_again() -> None:
    # With the first one high the second one has to be high as well; the third one alone suffices.
    best, _ = simplified((1.0, 1.0, 1.0), alone(3), lambda point: point[2] > 0 and (not point[0] or point[1] > 0))
    assert best == (0.0, 0.0, 1.0)


def test_a_nominal_point_that_fails_is_one_test_and_a_point_that_is_nominal_is_none() -> None:
    assert simplified((1.0, 1.0), alone(2), lambda _: True) == ((0.0, 0.0), [(0.0, 0.0)])
    assert simplified((0.0, 0.0), alone(2), lambda _: True) == ((0.0, 0.0), [])


def test_where_nothing_can_be_set_back_each_parameter_is_tried() -> None:
    best, tried = simplified((1.0,) * 4, alone(4), all)
    assert (best, len(tried)) == ((1.0,) * 4, 7)
