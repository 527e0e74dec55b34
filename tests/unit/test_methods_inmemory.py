"""Whole campaigns of methods `rigorous` and `scenario` in one process: windows, certificates, refutations, resumes."""

import json
import random
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from orchestrator import dispatch, service
from orchestrator.errors import Stopped
from orchestrator.service import Seen
from schemas.campaign import CampaignConfig
from tests.campaigns import table
from tests.inmemory import Faults, Log, Network, begin, campaign, run_of, serve, working
from workers import worker

pytestmark = pytest.mark.timeout(120)


def a_config(base: dict[str, Any], **changes: Any) -> CampaignConfig:
    return CampaignConfig.model_validate_json(json.dumps({**base, "max_attempts": 1000, **changes}))


def rigorous(**problem: Any) -> CampaignConfig:
    base = table("test-function-rigorous", resolution=9, max_tests=24, replicates=2)
    return a_config(base, problems=[{**base["problems"][0], **problem}])


def scenario(**changes: Any) -> CampaignConfig:
    """Five starts of the test function, whose `robustness` is .6 - value."""
    problem = {"name": "true_risk", "method": "scenario", "delta": 0.1, "alpha": 0.01, "replicates": 4, "window": 3}
    problem["linearised"] = {"centre": 0.3, "spread": 0.2}
    return a_config(
        table("test-function"),
        horizon=1.0,
        specification="always (value <= 0.6)",
        clip=[-0.5, 1.2],
        space={"scenarios": [[0.0, 0.0], [1.5, 0.0], [3.0, 1.0], [4.5, 2.0], [1.0, 3.0]]},
        problems=[problem],
        max_tests=20,
        **changes,
    )


CONFIGS = {"rigorous": rigorous(), "scenario": scenario()}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything as it is, in a tenth of the time."""
    monkeypatch.setattr(service, "TICK", 0.002)
    monkeypatch.setattr(service, "ADOPTION", 0.2)
    monkeypatch.setattr(worker, "HEARTBEAT", 0.04)
    monkeypatch.setattr(worker, "RESEND", 0.1)
    monkeypatch.setattr(dispatch, "Limits", partial(dispatch.Limits, resend_after=0.15, lost_after=0.3))


@pytest.mark.parametrize("method", CONFIGS)
def test_workers_losses_and_resumes_change_nothing(tmp_path: Path, method: str) -> None:
    config = CONFIGS[method]
    calm = campaign(tmp_path / "calm", config)
    assert campaign(tmp_path / "three", config, workers=3) == calm
    assert campaign(tmp_path / "lossy", config, workers=2, faults=Faults(1, loss=0.1, duplication=0.2)) == calm
    assert stopped_and_resumed(tmp_path / "stopped", config) == calm


def stopped_and_resumed(directory: Path, config: CampaignConfig) -> str:
    luck, stops = random.Random(5), 0
    begin(directory, config)
    with Network(Faults()) as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        while True:
            try:
                found = serve(directory, network, Log(), stop=partial(_after, luck.randint(0, 8)), resumed=stops > 0)
                break
            except Stopped:
                stops += 1
    assert stops
    return found


def _after(limit: int, seen: Seen) -> bool:
    return seen.recorded >= limit


def predicate(tmp_path: Path, config: CampaignConfig) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(campaign(tmp_path / "run", config, workers=2))["predicate"]
    return found


def test_a_rigorous_bound_holds_and_ends_with_the_budget(tmp_path: Path) -> None:
    found = predicate(tmp_path, rigorous())
    (problem,), (claim,) = found["problems"], found["claims"]
    assert problem["stopped_by"] == "budget"
    assert problem["partner"] <= 0.5 <= problem["bound"] == claim["bound"]
    assert (claim["quantity"], claim["sense"], claim["probability"]) == ("J_star", "<=", 0.95)
    assert not [each for each in found["assumptions"] if each["status"] == "refuted"]


def test_a_norm_bound_that_is_too_small_is_refuted_and_never_converges(tmp_path: Path) -> None:
    found = predicate(tmp_path, rigorous(rkhs_norm=0.25))
    (problem,) = found["problems"]
    assert problem["stopped_by"] == "refuted"
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert status["rkhs_norm/maximum"] == "refuted"
    assert "rkhs_norm/maximum" in found["claims"][0]["assumptions"]


def test_noise_zero_on_a_noisy_variant_is_refuted_not_accepted(tmp_path: Path) -> None:
    found = predicate(tmp_path, rigorous(noise_scale=0.0))
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert status["deterministic/maximum"] == "refuted"


def test_a_scenario_bound_is_below_the_least_robustness(tmp_path: Path) -> None:
    found = predicate(tmp_path, scenario())
    (problem,), (claim,) = found["problems"], found["claims"]
    assert problem["tests"] == 20
    assert problem["rollouts"] == {"nominal": 0, "true": 80}
    assert -0.5 < claim["bound"] < 0.6 - 0.4987  # sin(1.5) cos(0)/2 is the largest value of the five
    assert (claim["quantity"], claim["sense"], claim["probability"]) == ("rho_star", ">=", 0.9)
    assert {each["status"] for each in found["assumptions"]} <= {"derived", "assumed", "not refuted"}
