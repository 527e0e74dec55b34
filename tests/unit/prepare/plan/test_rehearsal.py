"""A problem rehearsed on a few rollouts: how many tests it may need, and what that rests on."""

import itertools
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign.plan import ProblemPlan, plan
from perfbound.orchestrator.prepare.plan import rehearsal
from perfbound.orchestrator.prepare.plan.rehearsal import PilotRollouts, Rehearsal, expected_tests, rehearsed
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.facts import Header
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.schemas.values import Guess
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.campaigns import config

SPEC = TestFunctionSystem().spec
STARTS = [(0.5, 0.5), (1.5, 4.0), (3.0, 2.0), (4.5, 5.5), (5.5, 1.0)]


def value(start: tuple[float, float]) -> float:
    return 0.5 * float(np.sin(start[0]) * np.cos(start[1]))


def trajectory(height: float) -> Trajectory:
    columns = tuple(column.name for column in SPEC.columns)
    return Trajectory(columns, np.array([[0.0, *[height] * (len(columns) - 1)]]))


def pilot(noise: float = 0.01) -> PilotRollouts:
    recorded: list[dict[str, list[Trajectory]]] = [
        {str(variant): [trajectory(value(start) + sign * noise) for sign in (-1, 1)] for variant in SPEC.variants}
        for start in STARTS
    ]
    return PilotRollouts(STARTS, recorded)


def problem(name: str, **changes: Any) -> tuple[ProblemPlan, Header]:
    campaign: CampaignConfig = config(name, **changes)
    return plan(campaign, SPEC, campaign.problems[0]), Header.new(campaign, SPEC, {}, run="plan")


def test_a_method_ends_where_alpha_is_reached() -> None:
    planned, header = problem("test-function")
    found = rehearsed(planned, header, pilot(), time=lambda: 0.0, most=1.0)
    assert found.verdict == "converged"
    assert 1 < found.tests < planned.budget
    tests, basis = expected_tests(planned, found)
    assert tests.low < found.tests == tests.middle < tests.high <= planned.budget
    assert str(found.tests) in basis


def test_the_share_of_a_rehearsal_is_that_of_its_tests_or_of_its_time() -> None:
    planned, header = problem("test-function-rigorous", max_tests=20)
    for most, shares in ((1000.0, [k / 20 for k in range(1, 21)]), (10.0, [min(1.0, 0.3 * k) for k in range(1, 5)])):
        told, ticks = list[float](), itertools.count()
        found = rehearsed(planned, header, pilot(), time=lambda: float(next(ticks)), most=most, done=told.append)  # noqa: B023
        assert told == pytest.approx(shares)
        assert len(told) == found.tests


def test_the_same_pilot_gives_the_same_tests() -> None:
    planned, header = problem("test-function-rigorous", max_tests=20)
    first, second = (rehearsed(planned, header, pilot(), time=lambda: 0.0, most=1.0) for _ in range(2))
    assert first.tests == 20
    assert first == second


@pytest.mark.rest
def test_a_rehearsal_ends_with_its_time_and_is_continued_by_the_forecast() -> None:
    planned, header = problem("test-function-rigorous")
    ticks = itertools.count()
    found = rehearsed(planned, header, pilot(), time=lambda: float(next(ticks)), most=200.0)
    assert found.verdict is None
    assert found.tests < planned.budget
    tests, basis = expected_tests(planned, found)
    assert "forecast" in basis
    assert found.tests <= tests.middle <= tests.high <= planned.budget


def test_a_smaller_tolerance_takes_more_tests() -> None:
    planned, header = problem("test-function", max_tests=100)
    lax = planned.problem.model_copy(update={"alpha": planned.problem.alpha * 3})  # type: ignore[operator]
    found = []
    for each in (lax, planned.problem):
        campaign = header.config.model_copy(update={"problems": (each,)})
        again = Header.new(campaign, SPEC, {}, run="plan")
        found.append(rehearsed(plan(campaign, SPEC, each), again, pilot(), time=lambda: 0.0, most=1.0).tests)
    assert found[0] < found[1]


def test_invented_values_that_contradict_the_constants_say_nothing() -> None:
    planned, _ = problem("test-function-rigorous")
    tests, basis = expected_tests(planned, Rehearsal(5, "refuted", (), 0.1))
    assert (tests, basis) == (Guess(planned.budget, 1, planned.budget), rehearsal.UNKNOWN)
    assert expected_tests(planned, None) == (tests, basis)


def test_the_nearest_start_counts_each_parameter_by_its_spread() -> None:
    planned, _ = problem("test-function")
    near = pilot(0.0).nearest(planned, (4.4, 5.4))
    assert {each.samples[0, 1] for each in near.values()} == {value(STARTS[3])}
