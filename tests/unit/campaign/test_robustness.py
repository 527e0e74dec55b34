"""Problem `robustness`: a claim about one simulator, exact without noise and without a clip, else about the mean."""

import hashlib
import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.campaign.admission import admit
from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.consistency import robustness_of
from perfbound.orchestrator.campaign.observation import Observer
from perfbound.orchestrator.campaign.plan import UNBOUNDED, plan
from perfbound.orchestrator.certificate.problem_results import objective
from perfbound.schemas.errors import CampaignError, EvidenceError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.system import SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory, encode
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.facts import facts, says
from tests.fakes import plain_function
from tests.fakes.inmemory import Faults, campaign, hurry
from tests.fakes.plain_function import CAMPAIGN, PlainFunction

PLAIN = PlainFunction().spec
NOISY = TestFunctionSystem().spec
LIST = {"scenarios": [[0.0, 0.0], [1.5, 0.0], [3.0, 1.0]]}
TWIN = {"name": "test-function"}


def config(
    *, system: dict[str, Any] | None = None, problem: dict[str, Any] | None = None, **keys: Any
) -> CampaignConfig:
    """Return the campaign of the plain function, changed; None removes a key of the problem."""
    found = tomllib.loads(CAMPAIGN) | keys
    found["system"] = system or found["system"]
    row = {**found["problems"][0], **(problem or {})}
    found["problems"] = [{key: value for key, value in row.items() if value is not None}]
    return CampaignConfig.model_validate_json(json.dumps(found))


KERNEL_KEYS = ("rkhs_norm", "noise_scale", "prior_mean", "kernel")
SCENARIO = {"method": "scenario", "delta": 0.1, "alpha": 0.01, "replicates": 4} | dict.fromkeys(KERNEL_KEYS)


def sample(value: float) -> Trajectory:
    """One sample, at time 0."""
    return Trajectory(("t", "value"), np.array([[0.0, value]]))


# The campaign file


def fault(old: str, new: str, spec: SystemSpec = PLAIN) -> str:
    text = CAMPAIGN if spec is PLAIN else CAMPAIGN.replace('"plain-function"', '"test-function"')
    assert old in text
    with pytest.raises(CampaignError) as caught:
        check(parse_campaign(text.replace(old, new).encode(), "c.toml"), spec, "c.toml")
    line = str(caught.value)
    assert "\n" not in line
    return line.removeprefix("c.toml: ")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "noise_scale = 0.0",
            "noise_scale = 0.1",
            "^clip: required 'robustness' [low high]",
        ),
        ("noise_scale = 0.0", 'noise_scale = "derived"', "^clip: required 'robustness'"),
        ('specification = "value <= 0.6"\n', "", "^specification: required 'robustness'"),
        ('name = "robustness"', 'name = "true_risk"', "^problems.true_risk.linearised: required 'true_risk'"),
        (
            'name = "robustness"',
            'name = "robustness"\nlinearised = { centre = 0.1, spread = 0.1 }',
            "^problems.robustness.linearised: required 'true_risk' 'rigorous'",
        ),
        ('name = "robustness"', 'name = "robustness"\nsense = "max"', "^problems.robustness.sense: 'max' 'min'"),
        ('composition = "single"', 'composition = "sum"', "^composition: 'sum' 'nominal_robustness'"),
        ('"value <= 0.6"', '"always[0,2] value <= 0.6"', "^specification: `always[0,2] value <= 0.6` 2 s"),
        ("max_tests = 200", "horizon = 2.0", "^horizon: 2 s more 1 s plain-function"),
    ],
)
def test_a_wrong_key_is_named_with_its_remedy(old: str, new: str, expected: str) -> None:
    assert says(fault(old, new), expected)


def test_a_variant_with_noise_needs_a_noise_scale() -> None:
    found = fault("noise_scale = 0.0", "noise_scale = 0", NOISY)
    assert says(found, "^problems.robustness.noise_scale: 0 true test-function")


def test_the_robustness_has_no_constants_of_a_risk() -> None:
    with pytest.raises(ValueError, match=facts("linearised: only 'true_risk' 'robustness'")):
        config(problem={**SCENARIO, "linearised": {"centre": 0.1, "spread": 0.1}}, space=LIST, clip=[-1, 1])


@pytest.mark.parametrize("text", ["value <= 0.6", "always value <= 0.6", "eventually[0,0] (value <= 0.6)"])
def test_a_formula_is_read_at_one_sample(text: str) -> None:
    found = config(specification=text)
    check(found, PLAIN, "c.toml")
    assert Observer(found, PLAIN).robustness(sample(0.5)) == pytest.approx(0.1)


# The plan and the observation


def test_without_noise_the_claim_is_about_the_robustness_itself() -> None:
    found = config()
    planned = plan(found, PLAIN, found.problems[0])
    assert (planned.clip, planned.hoeffding, planned.noise) == (UNBOUNDED, math.inf, 0.0)
    assert planned.rollouts == (("nominal", 0),)
    assert planned.statement.quantity == "robustness"
    assert objective(planned, 2) == "min over d of robustness"


def test_a_derived_noise_scale_is_that_of_the_variant_that_is_rolled_out() -> None:
    for spec, noise, quantity in ((PLAIN, 0.0, "robustness"), (NOISY, 0.85, "expected_robustness")):
        found = config(system={"name": spec.name}, problem={"noise_scale": "derived"}, clip=[-0.5, 1.2])
        planned = plan(found, spec, found.problems[0])
        assert (planned.noise, planned.statement.quantity) == (noise, quantity)


def test_the_mean_of_the_paper_has_the_noise_of_a_mean() -> None:
    changes = {"method": "paper", "noise_scale": 0.3, "c": 0.1, "replicates": 9, "window": None}
    found = config(system=TWIN, problem=changes, clip=[-0.5, 1.2])
    planned = plan(found, NOISY, found.problems[0])
    assert planned.noise == pytest.approx(0.1)
    assert {variant for variant, _ in planned.rollouts} == {"true"}


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5))
@settings(deadline=None)
def test_an_observation_is_the_mean_of_the_robustness_that_the_claim_is_about(values: list[float]) -> None:
    trajectories = {("nominal", k): sample(value) for k, value in enumerate(values)}
    for clip in (None, (-0.5, 1.2)):
        found, (low, high) = config(problem={"replicates": len(values)}, clip=clip), clip or UNBOUNDED
        observed = Observer(found, PLAIN).observe(plan(found, PLAIN, found.problems[0]), trajectories)
        expected = [min(max(0.6 - value, low), high) for value in values]
        assert observed.each == tuple(-value for value in expected)
        assert observed.y == pytest.approx(-math.fsum(expected) / len(values))


def test_method_scenario_observes_the_robustness() -> None:
    found = config(system=TWIN, problem=SCENARIO, space=LIST, clip=[-0.5, 1.2])
    trajectories = {("true", k): sample(value) for k, value in enumerate((0.1, 0.3, 5.0, 0.2))}
    observed = Observer(found, NOISY).observe(plan(found, NOISY, found.problems[0]), trajectories)
    assert observed.each == pytest.approx((0.5, 0.3, -0.5, 0.4))
    assert observed.y == pytest.approx(-0.175)


def test_the_robustness_is_found_in_the_replicates() -> None:
    exact, listed = (
        config().problems[0],
        config(system=TWIN, problem=SCENARIO, space=LIST, clip=[-0.5, 1.2]).problems[0],
    )
    assert robustness_of(exact, np.array([-0.1, -0.2, 0.3])).tolist() == [0.1, 0.2, -0.3]
    assert robustness_of(listed, np.array([0.1, 0.2, -0.3])).tolist() == [0.1, 0.2, -0.3]


def test_a_specification_beside_a_column_alone_has_no_robustness() -> None:
    """As before this problem existed: the certificate of `maximum` does not depend on it."""
    problem = {"name": "maximum", "column": "value", "noise_scale": 0.01}
    found = config(system=TWIN, problem=problem)
    assert Observer(found, NOISY).robustness(sample(0.5)) is None


# Whole rollouts


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0], None),
        ([0.5], "t = 0.5 s 0 s"),
        ([0.0, 0.5], "1 t = 0.5 s horizon 0 s"),
    ],
)
def test_at_horizon_0_one_sample_at_0_is_admitted(times: list[float], message: str | None) -> None:
    request = RequestTemplate.of(PLAIN, {}, horizon=0.0, visual=False).request(
        RolloutId("robustness", 0, "nominal", 0), (1.0, 2.0), 7
    )
    trajectory = Trajectory(("t", "value"), np.array([[time, 0.5] for time in times]))
    units = {column.name: column.unit for column in PLAIN.columns}
    payload = encode(trajectory, request=request.model_dump(mode="json"), metadata=request.metadata, units=units)
    sha256 = hashlib.sha256(payload).hexdigest()
    if message is None:
        assert admit(request, ("t", "value"), payload, sha256).samples.tolist() == [[0.0, 0.5]]
    else:
        with pytest.raises(EvidenceError, match=facts(message)):
            admit(request, ("t", "value"), payload, sha256)


# Whole campaigns


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch, tick=0.002)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(plain_function.install(tmp_path / "plugin"))


def predicate(directory: Path, found: CampaignConfig) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(campaign(directory, found, workers=2))["predicate"]
    return result


@pytest.mark.rest
@pytest.mark.usefixtures("installed")
def test_a_function_without_noise_gets_a_certain_claim_about_every_start(tmp_path: Path) -> None:
    calm = campaign(tmp_path / "run", config())
    found = json.loads(calm)["predicate"]
    (problem,), (claim,) = found["problems"], found["claims"]
    assert problem["stopped_by"] == "converged"
    assert problem["bound"] <= 0.1 <= problem["partner"] <= problem["bound"] + 0.05
    assert problem["objective"] == "min over d of robustness"
    assert (claim["quantity"], claim["sense"], claim["probability"]) == ("robustness", ">=", 1.0)
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert "clip/robustness" not in status
    assert status["deterministic/robustness"] == "assumed"
    assert "clip" not in found["question"]
    assert campaign(tmp_path / "lossy", config(), workers=2, faults=Faults(1, loss=0.1, duplication=0.2)) == calm


@pytest.mark.rest
@pytest.mark.usefixtures("installed")
def test_replicates_test_that_nothing_is_random(tmp_path: Path) -> None:
    found = predicate(tmp_path / "run", config(problem={"replicates": 2, "max_tests": 4}, clip=[0.2, 1.2]))
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert status["deterministic/robustness"] == "not refuted"
    assert status["clip/robustness"] == "derived"


@pytest.mark.rest
def test_with_noise_the_claim_is_about_the_expectation(tmp_path: Path) -> None:
    changes = {"noise_scale": 0.005, "max_tests": 24, "replicates": 2}
    found = predicate(tmp_path / "run", config(system=TWIN, problem=changes, clip=[-0.5, 1.2], resolution=9))
    (problem,), (claim,) = found["problems"], found["claims"]
    assert problem["bound"] <= 0.1 <= problem["partner"]
    assert problem["rollouts"] == {"nominal": 0, "true": 48}
    assert (claim["quantity"], claim["sense"], claim["probability"]) == ("expected_robustness", ">=", 0.95)


@pytest.mark.rest
def test_listed_starts_get_a_bound_of_the_least_mean(tmp_path: Path) -> None:
    changes = {**SCENARIO, "max_tests": 40}
    found = predicate(tmp_path / "run", config(system=TWIN, problem=changes, clip=[-0.5, 1.2], space=LIST))
    (problem,), (claim,) = found["problems"], found["claims"]
    least = 0.6 - math.sin(1.5) / 2
    assert problem["bound"] < least < problem["partner"]
    assert (claim["quantity"], claim["sense"], claim["probability"]) == ("expected_robustness", ">=", 0.9)
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert status["one_law_per_start/robustness"] == "not refuted"


@pytest.mark.rest
def test_the_paper_bounds_the_mean(tmp_path: Path) -> None:
    changes = {"method": "paper", "noise_scale": 0.005, "c": 0.01, "replicates": 2, "max_tests": 8, "window": None}
    found = predicate(tmp_path / "run", config(system=TWIN, problem=changes, clip=[-0.5, 1.2], resolution=9))
    assert found["claims"][0]["quantity"] == "expected_robustness"
    status = {each["id"]: each["status"] for each in found["assumptions"]}
    assert "centred_noise/robustness" not in status
