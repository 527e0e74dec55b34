"""What `perfbound plan` refuses before its pilot, and shows while it works."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from perfbound.orchestrator.campaign.checks import method_sizes
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.fleet.children.rollouts import ChildRolloutError
from perfbound.orchestrator.prepare.plan import plan
from perfbound.orchestrator.prepare.plan.fleet_need import NOTHING
from perfbound.orchestrator.prepare.plan.rehearsal import PilotRollouts
from perfbound.schemas.errors import CampaignError, PerfboundError
from perfbound.schemas.result.facts import Header
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.campaigns import config
from tests.facts import says
from tests.fakes.finished import a_pair
from tests.unit.prepare.plan import test_sizes

LONG = test_sizes.parsed(test_sizes.table("rigorous", 4, resolution=17))
"""A lattice as large as one of four parameters may be."""


def test_a_plan_refuses_before_its_pilot_what_a_run_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "simulated_spec", lambda *_: TestFunctionSystem().spec)
    hiding = a_pair("rigorous").model_copy(update={"clip": (0.0, 1.0)})
    with pytest.raises(CampaignError, match=r"c\.toml: clip: its lower end 0 hides violations"):
        plan.plan_campaign(hiding, Path("c.toml"), 1)


def test_a_plan_shows_system_and_pilot_rollouts_as_they_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    def simulated(_system: object, wanted: Sequence[object], _folder: Path, done: Callable[[int], None]) -> None:
        done(3)
        raise ChildRolloutError(f"{len(wanted)} rollouts")

    monkeypatch.setattr(plan, "simulated_spec", lambda *_: TestFunctionSystem().spec)
    monkeypatch.setattr(plan, "simulate_in_child", simulated)
    shown: list[tuple[str, int, int]] = []
    with pytest.raises(PerfboundError, match=r"c\.toml: 10 rollouts"):
        plan.plan_campaign(config("test-function-rigorous"), Path("c.toml"), 1, lambda *each: shown.append(each))
    assert shown == [("system", 0, 1), ("system", 1, 1), (plan.PILOT, 0, 10), (plan.PILOT, 3, 10)]


def test_mathematics_of_many_hours_are_said_before_the_campaign() -> None:
    (line,) = plan.long_mathematics(LONG)
    assert says(line, "robustness: 2,000 83,521 h max_tests resolution")
    for few in (test_sizes.table("rigorous", 3), test_sizes.table("sample", 40), test_sizes.table("kriging", 3)):
        assert list(plan.long_mathematics(test_sizes.parsed(few))) == []


def test_the_memory_of_a_plan_is_that_of_the_cost_model() -> None:
    for method, parameters in (("rigorous", 3), ("kriging", 2), ("sample", 6)):
        config = test_sizes.parsed(test_sizes.table(method, parameters, max_tests=300))
        header = Header.new(config, test_sizes.spec(parameters), {})
        (whole,) = plans(config, header.spec).values()
        found = plan._problem_size(header, whole, None)
        (size,) = [size for _, size in method_sizes(config)]
        assert found.matrices.high == size.memory
        assert found.matrices.low == 0.0
        assert (found.thinking == NOTHING) == (method != "kriging")


def test_weights_that_take_longer_than_a_rehearsal_are_not_rehearsed() -> None:
    config = test_sizes.parsed(test_sizes.table("kriging", 3, problem={"points": 6}))
    header = Header.new(config, test_sizes.spec(3), {})
    (whole,) = plans(config, header.spec).values()
    reported: list[tuple[str, int, int]] = []
    pilot = PilotRollouts([(0.0, 0.0, 0.0)], [{}])
    assert plan._rehearsal(whole, header, pilot, lambda *each: reported.append(each)) is None
    assert reported == []
    assert plan._problem_size(header, whole, None).thinking.middle > plan.REHEARSAL
