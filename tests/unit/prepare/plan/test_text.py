"""The plan of a campaign in words."""

import json

from perfbound.orchestrator.prepare.plan.fleet_need import PilotFigures, ProblemSize, fleet_plan
from perfbound.orchestrator.prepare.plan.text import plan_json, plan_limits, plan_rows
from perfbound.schemas.values import Guess


def problem(window: int = 1) -> ProblemSize:
    return ProblemSize("true_risk", Guess(100, 50, 100), 8, window, "rehearsed: the whole budget")


PILOT = PilotFigures(10, 10.0, 9.0, 2.0, 100_000.0, 97_000_000)


def test_workers_without_work_are_counted() -> None:
    (first, second) = plan_limits(fleet_plan(64, PILOT, [problem()], [], 10.0))
    assert "at most 8 rollouts can run side by side" in first
    assert "56 workers of 64 will wait" in second
    assert len(plan_limits(fleet_plan(8, PILOT, [problem()], [], 10.0))) == 1


def test_the_limit_of_the_orchestrator_is_said() -> None:
    fast = PilotFigures(10, 0.01, 0.01, 2.0, 100_000.0, 97_000_000)
    assert any("The orchestrator limits" in line for line in plan_limits(fleet_plan(64, fast, [problem(64)], [], 10.0)))
    assert not any(
        "The orchestrator limits" in line for line in plan_limits(fleet_plan(64, PILOT, [problem(64)], [], 10.0))
    )


def test_the_table_has_each_problem_and_its_reason() -> None:
    found = {row[0].strip(): row[1:] for row in plan_rows(fleet_plan(8, PILOT, [problem()], [], 10.0))}
    assert found["true_risk"] == ("800", "400 to 800", "rehearsed: the whole budget, 8 a test")
    assert found["memory of a worker"][0] == "97 MB"


def test_json_has_seconds_and_bytes() -> None:
    found = json.loads(plan_json(fleet_plan(8, PILOT, [problem()], [], 10.0), "segway"))
    assert (found["campaign"], found["workers"], found["orchestrator_limits"]) == ("segway", 8, False)
    assert found["rollouts"] == {"middle": 800, "low": 400, "high": 800}
    assert found["pilot"]["size"] == 100_000.0


def test_second_opinions_have_a_row_where_there_are_any() -> None:
    plain, compared = (
        {row[0]: row[1:] for row in plan_rows(fleet_plan(8, PILOT, [problem()], [], 10.0, second_opinion=share))}
        for share in (0.0, 0.1)
    )
    assert "second opinions" not in plain
    assert compared["second opinions"][:2] == ("91", "40 to 102")
