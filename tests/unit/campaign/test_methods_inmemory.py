"""Whole campaigns in one process, method by method: windows, certificates, refutations, resumes."""

import json
import random
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.run.service import RunStatus
from perfbound.schemas.errors import CampaignError, Stopped
from perfbound.schemas.file.config import CampaignConfig
from tests.campaigns import table
from tests.fakes.inmemory import Faults, Log, Network, begin, campaign, hurry, run_of, serve, working


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


def requirements() -> CampaignConfig:
    """The same starts, two requirements of the risk, each with its own constants."""
    own = {"linearised": {"centre": 0.4, "spread": 0.2}, "alpha": 0.02}
    formulas = {"below": "always (value <= 0.6)", "above": "always (value >= -0.4)"}
    listed = [{"name": name, "formula": formula} for name, formula in formulas.items()]
    base = scenario().model_dump(mode="json", exclude_unset=True)
    return a_config({**base, "specification": None}, specifications=[listed[0], listed[1] | own])


def refined() -> CampaignConfig:
    """Method `paper` with points between the nodes."""
    base = table("test-function", resolution=9, max_tests=20)
    return a_config(base, problems=[{**base["problems"][0], "refine": True, "alpha": 0.001}])


CONFIGS = {"refined": refined(), "rigorous": rigorous(), "scenario": scenario(), "requirements": requirements()}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything as it is, in a tenth of the time."""
    hurry(monkeypatch, tick=0.002)


@pytest.mark.rest
@pytest.mark.parametrize("method", CONFIGS)
def test_workers_losses_and_resumes_change_nothing(tmp_path: Path, method: str) -> None:
    config = CONFIGS[method]
    calm = campaign(tmp_path / "calm", config)
    assert campaign(tmp_path / "three", config, workers=3) == calm
    assert campaign(tmp_path / "lossy", config, workers=2, faults=Faults(1, loss=0.1, duplication=0.2)) == calm
    assert stopped_and_resumed(tmp_path / "stopped", config) == calm


def stopped_and_resumed(directory: Path, config: CampaignConfig) -> str:
    rng, stops = random.Random(5), 0
    begin(directory, config)
    with Network(Faults()) as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        while True:
            try:
                found = serve(directory, network, Log(), stop=partial(_after, rng.randint(0, 8)), resumed=stops > 0)
                break
            except Stopped:
                stops += 1
    assert stops
    return found


def _after(limit: int, seen: RunStatus) -> bool:
    return seen.recorded >= limit


def predicate(tmp_path: Path, config: CampaignConfig) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(campaign(tmp_path / "run", config, workers=2))["predicate"]
    return found


@pytest.mark.rest
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


def test_noise_zero_on_a_variant_that_is_declared_noisy_is_not_accepted(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="noise_scale: 0 has no meaning"):
        campaign(tmp_path / "run", rigorous(noise_scale=0.0))


def test_a_noise_scale_far_too_small_is_refuted_by_the_replicates(tmp_path: Path) -> None:
    base = table("test-function-rigorous", resolution=5, max_tests=6, replicates=8)
    base["system"] = {"name": "test-function", "noise_sd": 0.5}
    found = predicate(tmp_path, a_config(base))
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert status["replicate_spread/maximum"] == "refuted"
    assert "replicate_spread/maximum" in found["claims"][0]["refuted"]


def pair(nominal: dict[str, Any], gap: dict[str, Any], **changes: Any) -> CampaignConfig:
    """A pair of problems over five listed starts, or a box, of the test function."""
    kernel = {"nu": 2.5, "length_scale": 2.0}
    problems = [
        {"name": "nominal_robustness", "delta": 0.05, "alpha": 0.05, "rkhs_norm": 1.0, "kernel": kernel, **nominal},
        {"name": "sim_gap", "delta": 0.05, "alpha": 0.05, "rkhs_norm": 1.0, "kernel": kernel, **gap},
    ]
    base = table("test-function", problems=problems, composition="sum", horizon=1.0, resolution=5, max_tests=6)
    return a_config(
        base, specification="always (value <= 0.6)", clip=[-0.5, 1.2], gap={"kind": "robustness"}, **changes
    )


EXACT = {"method": "rigorous", "noise_scale": 0.0}
NOISY = {"method": "rigorous", "noise_scale": "derived", "replicates": 2}
PAPER = {"method": "paper", "noise_scale": 0.1, "c": 0.2}
LIST = {"scenarios": [[0.0, 0.0], [1.5, 0.0], [3.0, 1.0], [4.5, 2.0], [1.0, 3.0]]}


@pytest.mark.parametrize(("nominal", "gap"), [(PAPER, NOISY), (EXACT, PAPER), (EXACT, NOISY), (PAPER, PAPER)])
def test_a_composed_claim_is_no_surer_than_its_problems(
    tmp_path: Path, nominal: dict[str, Any], gap: dict[str, Any]
) -> None:
    found = predicate(tmp_path, pair(nominal, gap))
    failures = sum(1 - problem["probability"] for problem in found["problems"])
    first = found["claims"][0]
    assert first["rule"] == "sum"
    assert first["probability"] == pytest.approx(1 - failures, abs=3e-9)
    assert first["probability"] <= 1 - failures + 1e-12
    assert "lipschitz/sim_gap" in first["assumptions"]
    assert "independence" not in first["assumptions"]


def test_a_list_of_starts_is_said_and_ends_when_every_start_is_known(tmp_path: Path) -> None:
    found = predicate(tmp_path, pair({**EXACT, "window": 2}, NOISY, space=LIST))
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert status["finite_space/nominal_robustness"] == status["finite_space/sim_gap"] == "derived"
    assert found["problems"][0]["tests"] <= 5
    assert found["question"]["space"] == LIST


def test_a_column_that_does_not_carry_the_robustness_over_is_refuted(tmp_path: Path) -> None:
    """Robustness of 5 value moves five times as fast as value: L = 1 is wrong, and every pair of rollouts shows it."""
    config = pair(EXACT, NOISY)
    gap = {"kind": "signal_sup", "column": "value", "lipschitz": 1.0}
    raw = {**json.loads(config.model_dump_json(exclude_none=True)), "specification": "always (5 * value <= 0.6)"}
    wrong = a_config({**raw, "gap": gap, "system": {"name": "test-function", "noise_sd": 0.1}, "clip": [-3.0, 4.0]})
    found = predicate(tmp_path, wrong)
    assert {each["id"]: each["status"] for each in found["assumptions"]}["lipschitz/sim_gap"] == "refuted"
    assert "lipschitz/sim_gap" in found["claims"][0]["refuted"]


def test_a_scenario_bound_is_below_the_least_robustness(tmp_path: Path) -> None:
    found = predicate(tmp_path, scenario())
    (problem,), (claim,) = found["problems"], found["claims"]
    assert problem["tests"] == 20
    assert problem["rollouts"] == {"nominal": 0, "true": 80}
    assert -0.5 < claim["bound"] < 0.6 - 0.4987  # sin(1.5) cos(0)/2 is the largest value of the five
    assert (claim["quantity"], claim["sense"], claim["probability"]) == ("rho_star", ">=", 0.9)
    assert {each["status"] for each in found["assumptions"]} <= {"derived", "assumed", "not refuted"}
