"""Clusters of failing starts: of one kind what has nothing that passes in between, of another what has."""

import numpy as np

from perfbound.orchestrator.mathematics.search.clusters import NEAR, Clusters, Point


def between(one: Point, other: Point) -> Point:
    return tuple(((np.array(one) + np.array(other)) / 2).tolist())


def clusters(parameters: int, high: float = 1.0) -> Clusters[int]:
    return Clusters((0.0,) * parameters, (high,) * parameters, between)


def fed(found: Clusters[int], *tests: tuple[Point, float], violated: tuple[int, ...] = ()) -> Clusters[int]:
    """Feed tests, each with its number, of which those below 0 violate the same parts."""
    for number, (start, margin) in enumerate(tests):
        found.observe(start, margin, violated if margin < 0 else (), number)
    return found


def sizes(found: Clusters[int]) -> list[int]:
    return [len(each.failures) for each in found.found]


def test_a_passing_test_changes_nothing() -> None:
    found = fed(clusters(2), ((0.5, 0.5), 1.0), ((0.1, 0.1), 0.0))
    assert (sizes(found), found.undecided, found.middles) == ([], 0, [])


def test_near_starts_are_of_one_cluster_in_shares_of_the_ranges() -> None:
    assert sizes(fed(clusters(1, high=50.0), ((10.0,), -1.0), ((10.0 + 49.0 * NEAR,), -1.0))) == [2]
    found = fed(clusters(1, high=50.0), ((10.0,), -1.0), ((10.0 + 51.0 * NEAR,), -1.0))
    assert (sizes(found), found.undecided) == ([1], 1)


def test_other_violated_parts_are_another_cluster_wherever_they_are() -> None:
    found = fed(clusters(2), ((0.5, 0.5), -1.0), violated=(0,))
    fed(found, ((0.5, 0.5), -1.0), violated=(0, 1))
    assert [each.violated for each in found.found] == [(0,), (0, 1)]


def test_the_middle_decides_and_joins_by_failing_with_the_same_parts() -> None:
    for margin, violated, expected in ((-1.0, (0,), [3]), (-1.0, (1,), [1, 1, 1]), (1.0, (), [1, 1])):
        found = fed(clusters(2), ((0.1, 0.1), -1.0), ((0.9, 0.9), -1.0), violated=(0,))
        assert found.middles == [(0.5, 0.5)]
        found.observe((0.5, 0.5), margin, violated, 2)
        assert (sizes(found), found.undecided, found.middles) == (expected, 0, [])


def test_a_middle_that_cannot_be_tested_is_as_one_that_passes() -> None:
    found = Clusters[int]((0.0,), (1.0,), lambda *_: None)
    assert sizes(fed(found, ((0.1,), -1.0), ((0.9,), -1.0))) == [1, 1]


def test_starts_of_a_list_with_nothing_in_between_are_of_one_cluster() -> None:
    found = Clusters[int]((0.0,), (1.0,), min)
    assert sizes(fed(found, ((0.1,), -1.0), ((0.9,), -1.0))) == [2]


def test_a_middle_that_was_tested_before_is_not_asked_for() -> None:
    assert sizes(fed(clusters(1), ((0.5,), 1.0), ((0.1,), -1.0), ((0.9,), -1.0))) == [1, 1]


def test_each_cluster_with_the_same_parts_is_asked_about() -> None:
    found = fed(clusters(1), ((0.0,), -1.0), ((0.5,), -1.0), ((0.25,), 1.0), ((1.0,), -1.0))
    assert (sizes(found), found.middles) == ([1, 1], [(0.75,)])
    found.observe((0.75,), 1.0, (), 4)
    # It is not of the nearest one. In the middle between it and the other one is a failure, but of the nearest one.
    assert (sizes(found), found.undecided) == ([1, 1, 1], 0)


def test_a_failure_that_waits_joins_a_cluster_that_has_grown_up_to_it() -> None:
    found = fed(clusters(1), ((0.1,), -1.0), ((0.5,), -1.0), ((0.19,), -1.0), ((0.28,), -1.0), ((0.37,), -1.0))
    assert found.undecided == 1
    found.observe((0.42,), -1.0, (), 5)
    assert (sizes(found), found.undecided) == ([6], 0)


def test_the_worst_one_is_the_first_of_equal_ones() -> None:
    (found,) = fed(clusters(1), ((0.1,), -1.0), ((0.12,), -2.0), ((0.11,), -2.0)).found
    assert (found.worst.test, found.box) == (1, ((0.1,), (0.12,)))


def test_forty_parameters_of_which_two_matter_are_two_kinds_of_failure() -> None:
    def margin(start: Point) -> float:
        return min(max(0.8 - start[0], 0.8 - start[1]), max(0.8 - start[2], 0.8 - start[3]))

    rng = np.random.default_rng(3)
    found = clusters(40)
    for test in range(60):
        start = rng.random(40)
        start[:4] = (0.9, 0.9, 0.1, 0.1) if test % 2 else (0.1, 0.1, 0.9, 0.9)
        found.observe(tuple(start.tolist()), -0.1, (), test)
        while middles := found.middles:
            found.observe(middles[0], margin(middles[0]), (), test)
    assert len(found.found) == 2
    # What a search then keeps out of: starts of these kinds, whatever the other parameters are, and no others.
    others = rng.random((100, 36))
    for matter, expected in (((0.9, 0.9, 0.1, 0.1), True), ((0.1, 0.1, 0.9, 0.9), True), ((0.1, 0.1, 0.1, 0.1), False)):
        known = found.near(np.hstack([np.tile(matter, (100, 1)), others]))
        assert (known == expected).mean() >= 0.95
