"""Groups of violating starts: single linkage in the box, scaled to the unit cube."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.linkage import NEAR
from perfbound.orchestrator.report.collect import violations
from perfbound.orchestrator.report.collect.violations import grouped
from perfbound.orchestrator.report.data.rollouts import StartGroup, ViolatingStart

BOX = [(0.0, 100.0), (-1.0, 1.0)]


def start(*x: float, worst: float = -1.0, violations: int = 1, rollouts: int = 2) -> ViolatingStart:
    return ViolatingStart(x, violations, rollouts, worst, "true_risk", 0)


def near(one: ViolatingStart, other: ViolatingStart) -> bool:
    widths = [high - low for low, high in BOX]
    return all(abs(a - b) / width <= NEAR + 1e-9 for a, b, width in zip(one.x, other.x, widths, strict=True))


starts = st.lists(
    st.builds(
        lambda i, j, worst: start(5.0 * i, 0.1 * j - 1.0, worst=-0.1 * worst),
        st.integers(0, 20),
        st.integers(0, 20),
        st.integers(1, 9),
    ),
    max_size=25,
    unique_by=lambda each: each.x,
)


@given(starts)
def test_near_starts_are_in_one_group_and_groups_are_apart(found: list[ViolatingStart]) -> None:
    groups = grouped(found, BOX).groups
    assert sorted(each.x for group in groups for each in group.starts) == sorted(each.x for each in found)
    for k, group in enumerate(groups):
        for other in groups[k + 1 :]:
            assert not any(near(one, two) for one in group.starts for two in other.starts)
        reached, left = [group.starts[0]], list(group.starts[1:])
        while step := [each for each in left if any(near(each, one) for one in reached)]:
            reached += step
            left = [each for each in left if each not in step]
        assert left == [], "a chain of near starts joins the group"


@given(starts, st.randoms())
def test_the_groups_do_not_depend_on_the_order(found: list[ViolatingStart], order: random.Random) -> None:
    mixed = list(found)
    order.shuffle(mixed)
    assert grouped(mixed, BOX) == grouped(found, BOX)


@given(starts)
def test_counts_ranges_and_order_follow_from_the_starts(found: list[ViolatingStart]) -> None:
    result = grouped(found, BOX)
    assert result.starts == len(found)
    assert [group.worst for group in result.groups] == sorted(group.worst for group in result.groups)
    for group in result.groups:
        assert group.worst == group.starts[0].worst == min(each.worst for each in group.starts)
        assert group.violations == sum(each.violations for each in group.starts)
        assert group.rollouts == sum(each.rollouts for each in group.starts)
        for k, (low, high) in enumerate(zip(group.low, group.high, strict=True)):
            assert (low, high) == (min(each.x[k] for each in group.starts), max(each.x[k] for each in group.starts))


def test_the_nodes_of_a_lattice_of_ten_steps_are_near() -> None:
    """Also where a step is a tenth of the range only up to round-off."""
    nodes = [start(0.7 + 0.1 * k, worst=-1.0 - k) for k in range(3)]
    (group,) = grouped(nodes, [(0.7, 1.7)]).groups
    assert len(group.starts) == 3
    assert len(grouped([start(0.0), start(0.101)], [(0.0, 1.0)]).groups) == 2


def test_a_parameter_of_one_value_divides_nothing() -> None:
    (group,) = grouped([start(3.0, 5.0), start(3.5, 5.0)], [(0.0, 10.0), (5.0, 5.0)]).groups
    assert (group.low, group.high) == ((3.0, 5.0), (3.5, 5.0))


def test_a_system_without_parameters_has_one_group() -> None:
    (group,) = grouped([start()], []).groups
    assert group == StartGroup((), (), (start(),), 1, 2, -1.0)


def test_starts_beyond_the_limit_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(violations, "MOST_STARTS", 2)
    found = grouped([start(10.0 * k, worst=-1.0 - k, violations=k + 1, rollouts=10) for k in range(5)], [(0.0, 100.0)])
    assert [each.worst for group in found.groups for each in group.starts] == [-5.0, -4.0]
    assert (found.starts, found.other_starts, found.other_violations, found.other_rollouts) == (5, 3, 1 + 2 + 3, 30)
