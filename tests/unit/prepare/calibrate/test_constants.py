"""The proposals of a calibration: its budget, its starts and seeds, its constants, and the file that has them."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.campaign import plan as plans
from perfbound.orchestrator.mathematics.calibration.noise import NOISIEST
from perfbound.orchestrator.mathematics.calibration.steepness import PLACES
from perfbound.orchestrator.mathematics.calibration.trust import DOUBTED
from perfbound.orchestrator.prepare.calibrate import tolerance
from perfbound.orchestrator.prepare.calibrate.budget import FACTORS, BudgetForecast, division
from perfbound.orchestrator.prepare.calibrate.calibrate import Calibration, CalibrationWish, with_file
from perfbound.orchestrator.prepare.calibrate.constants import CONSTANTS, Constant, calibrated, linearised_constants
from perfbound.orchestrator.prepare.calibrate.design import Box, RolloutBudget, calibration_seed
from perfbound.orchestrator.prepare.calibrate.file import kernel_file, sample_file, without_keys
from perfbound.orchestrator.prepare.calibrate.pilot import CalibrationPilot
from perfbound.orchestrator.prepare.calibrate.tolerance import ToleranceForecast
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.draft import CLIP, Draft, load_draft
from perfbound.schemas.file.problem_models import KrigingProblem, RigorousProblem
from perfbound.schemas.file.reader import parse_campaign
from tests.studies.coverage.calibration import FunctionRollouts, spec
from tests.studies.coverage.functions import Floats
from tests.studies.coverage.spot_checks import OBSERVED

HEAD = 'specification = "value >= 0"\nsystem.name = "any-function"\nspace.z1 = [0, 5]\nspace.z2 = [0, 5]\n'


PAPER = "method = 'paper'\nalpha = 1\nc = 1\nrkhs_norm = 1\nnoise_scale = 1\nkernel = { length_scale = 1 }\n"


def read(tmp_path: Path, text: str) -> Draft:
    path = tmp_path / "any-function.toml"
    path.write_text(text)
    return load_draft(path)


# Budget, starts, seeds


@given(st.integers(150, 5000), st.booleans())
def test_the_budget_is_spent_and_not_exceeded(rollouts: int, noisy: bool) -> None:
    found = RolloutBudget.of(rollouts, noisy=noisy)
    spent = found.starts * found.replicates + PLACES * found.halvings * found.at_halves
    spent += NOISIEST * found.at_noisiest + DOUBTED * found.at_doubted
    assert rollouts - found.replicates < spent <= rollouts
    assert found.starts >= 32


@pytest.mark.rest
def test_starts_are_distinct_in_the_region_and_nested() -> None:
    box = Box(("x", "y"), np.array([0.0, -3.0]), np.array([5.0, 3.0]), "x^2 + y^2 <= 16")
    starts = box.space_filling(200, 1)
    assert len(set(starts)) == 200
    assert all(math.hypot(*each) <= 4 and each[0] >= 0 for each in starts)
    assert box.space_filling(50, 1) == starts[:50]
    assert box.space_filling(50, 2) != starts[:50]
    assert np.allclose(box.starts(box.shares(starts)), starts)
    with pytest.raises(CampaignError, match="region"):
        Box(("x",), np.array([0.0]), np.array([1.0]), "x >= 2").space_filling(3, 1)


def test_seeds_differ_and_have_the_bits_of_the_system() -> None:
    system = spec(noisy=True).model_copy(update={"seed_bits": 31})
    seeds = {
        calibration_seed(digest, seed, (test, replicate), variant, system)
        for digest in ("a", "b")
        for seed in (1, 2)
        for test in range(20)
        for replicate in range(3)
        for variant in ("nominal", "true")
    }
    assert len(seeds) == 2 * 2 * 20 * 3 * 2
    assert all(0 <= each < 2**31 for each in seeds)


# Drafts


def test_a_draft_needs_no_constants(tmp_path: Path) -> None:
    found = read(tmp_path, HEAD)
    assert found.clip is None
    assert found.config.clip == CLIP
    assert found.config.name == "any-function"
    assert dict(found.given(0)) == dict(found.table)
    given = read(tmp_path, f"alpha = 0.1\nrkhs_norm = 3\nclip = [-1, 1]\n{HEAD}")
    assert given.clip == (-1, 1)
    assert given.given(0)["alpha"] == 0.1


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (f"{HEAD}[[claims]]\nquantity = 'mean'\n", "claims: decides what is claimed"),
        (f"falsify = {{}}\n{HEAD}", "falsify: a search needs no constants"),
        (f"{PAPER}{HEAD}", "'paper' has no constants"),
        ("method = 'scenario'\ncandidates = 9\nalpha = 1\nclip = [-1, 1]\n" + HEAD, "'scenario' has no constants"),
        (HEAD.replace("z1 = [0, 5]\nspace.z2 = [0, 5]", "scenarios = [[0, 1]]"), "space: a kernel on a list"),
        (f"rkhs_nrm = 1\n{HEAD}", "did you mean 'rkhs_norm'"),
        (f"problems = 3\n{HEAD}", "problems: 3 is not allowed"),
    ],
)
def test_the_error_of_a_file_that_is_no_draft_names_key_and_remedy(tmp_path: Path, text: str, part: str) -> None:
    with pytest.raises(CampaignError, match=r"any-function\.toml: ") as found:
        read(tmp_path, text)
    assert part in str(found.value)
    assert "\n" not in str(found.value)


# Proposals


def function(z: Floats) -> Floats:
    return np.asarray(1.0 + np.sin(z[:, 0]) * np.cos(z[:, 1]))


def result(tmp_path: Path, text: str, *, noisy: bool, **more: Any) -> Calibration:
    draft, system = read(tmp_path, text), spec(noisy=noisy)
    observed = OBSERVED[1] if noisy else OBSERVED[0]
    simulated = FunctionRollouts(np.random.default_rng(1), more.get("function", function), observed)
    pilot = CalibrationPilot(draft, 0, system, simulated, propose_clip=noisy and draft.clip is None)
    proposal = pilot.calibrated(more.get("rollouts", 400), 1)
    wish = CalibrationWish(tmp_path / "any-function.toml", 400, 1, 1, tmp_path / "c.toml")
    return with_file(Calibration(wish, draft, system, pilot.clip, (proposal,), (), None))


@pytest.mark.rest
@pytest.mark.parametrize("noisy", [False, True])
def test_every_constant_has_a_reason_and_the_file_has_all_of_them(tmp_path: Path, noisy: bool) -> None:
    found = result(tmp_path, HEAD, noisy=noisy)
    keys = found.problems[0].keys
    expected = {"prior_mean", "kernel", "rkhs_norm", "noise_scale", "alpha", "max_tests"}
    assert keys.keys() == expected | ({"replicates"} if noisy else set())
    assert all(each.reason.endswith(".") for each in found.problems[0].constants)
    assert found.text is not None
    config = parse_campaign(found.text.encode(), "c.toml")
    problem = config.problems[0]
    assert isinstance(problem, RigorousProblem)
    assert problem.rkhs_norm == keys["rkhs_norm"]
    assert problem.kernel.model_dump(exclude_unset=True) == keys["kernel"]
    assert config.max_tests == keys["max_tests"]
    assert (config.clip is None) != noisy
    measured = found.problems[0].measured
    assert np.abs(measured.data.values - problem.prior_mean).max() <= problem.rkhs_norm
    if noisy:
        assert 0.1 <= float(problem.noise_scale) <= 0.3  # the noise has a standard deviation of .1
        assert config.clip is not None
        assert config.clip[0] < -measured.values.max()
        assert -measured.values.min() < config.clip[1]
    else:
        assert problem.noise_scale == 0
    assert measured.rollouts <= 400
    (forecast,) = found.forecasts
    assert isinstance(forecast, ToleranceForecast)
    assert forecast.tests is not None
    assert forecast.budget >= forecast.tests


@pytest.mark.parametrize(("text", "noisy"), [(HEAD, True), (f"clip = [-1.5, 0.5]\n{HEAD}", True), (HEAD, False)])
def test_the_share_at_an_end_of_the_clip_is_known_where_there_is_one(tmp_path: Path, text: str, noisy: bool) -> None:
    measured = result(tmp_path, text, noisy=noisy, rollouts=150).problems[0].measured
    if not noisy:
        assert measured.clipped is None
        return
    assert measured.clipped is not None
    assert (measured.clipped > 0.0) == text.startswith("clip"), "a clip of its own contains all values"


def test_an_alpha_that_no_budget_reaches_is_kept_where_a_user_has_chosen_it_and_raised_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tolerance, "MOST_TESTS", 20)
    monkeypatch.setattr(tolerance, "LARGEST_BUDGET", 20)
    chosen, raised = (
        result(tmp_path, f"{alpha}{HEAD}", noisy=False, rollouts=150).forecasts[0] for alpha in ("alpha = 1e-3\n", "")
    )
    assert isinstance(chosen, ToleranceForecast)
    assert isinstance(raised, ToleranceForecast)
    assert (chosen.tests, chosen.alpha) == (None, 1e-3)
    assert raised.tests == 20


COARSE = f"clip = [-1, 3]\nresolution = 5\n{HEAD}"


def gentle(z: Floats) -> Floats:
    return np.asarray(1.0 + 0.5 * np.sin(z[:, 0] / 2) * np.cos(z[:, 1] / 3))


@pytest.mark.rest
@pytest.mark.parametrize("noisy", [False, True])
def test_a_planned_method_gets_its_budget_from_the_bounds_of_several(tmp_path: Path, noisy: bool) -> None:
    found = result(tmp_path, f'method = "kriging"\n{COARSE}', noisy=noisy, function=gentle)
    keys = found.problems[0].keys
    assert keys.keys() == {"prior_mean", "kernel", "rkhs_norm", "spread", "replicates", "max_tests"}
    assert found.text is not None
    config = parse_campaign(found.text.encode(), "c.toml")
    problem = config.problems[0]
    assert isinstance(problem, KrigingProblem)
    assert (problem.rkhs_norm, problem.spread, config.resolution) == (keys["rkhs_norm"], keys["spread"], 5)
    (forecast,) = found.forecasts
    assert isinstance(forecast, BudgetForecast)
    proposed = forecast.proposed
    assert (config.max_tests, config.replicates) == (proposed.tests, proposed.replicates)
    assert [each.enters / proposed.enters for each in forecast.budgets] == pytest.approx(FACTORS, rel=0.05)
    # J falls with the budget, towards the largest J of the function and never below it; from one to the next it may
    # rise, because a larger plan trusts the fit between the points more.
    middles = [each.bound.middle for each in forecast.budgets]
    assert all(each.bound.low <= each.bound.middle <= each.bound.high for each in forecast.budgets)
    assert forecast.without >= middles[0] > middles[-1] > forecast.fitted - 0.05
    assert forecast.fitted == pytest.approx(-0.95, abs=0.1), "the worst start has .95"
    numbers = forecast.numbers["budgets"]
    assert numbers[0]["bound"] == -middles[0]
    assert numbers[0]["range"][0] <= numbers[0]["bound"] <= numbers[0]["range"][1]
    if noisy:
        assert 0.05 <= float(problem.spread or 0) <= 0.15  # the noise has a standard deviation of .1
        measured, choice = found.problems[0].measured, found.problems[0].choice
        finer = {each.key: each.value for each in CONSTANTS["kriging"](measured, choice, choice.chosen, {})}
        assert finer["resolution"] == 41, "where the draft gives none"


@pytest.mark.rest
def test_another_method_is_named_where_it_may_be_expected_to_prove_more(tmp_path: Path) -> None:
    (compared,) = result(tmp_path, COARSE, noisy=True, function=gentle).instead
    assert compared.kriging.low <= compared.kriging.middle <= compared.kriging.high
    assert (compared.sign, compared.problem) == (-1, "robustness")
    assert -1.0 < compared.default < -0.5, "the default comes near the worst start, .95"
    assert compared.is_tighter == (compared.kriging.high < compared.default)
    assert replace(compared, default=compared.kriging.high + 1e-9).is_tighter
    assert not replace(compared, default=compared.kriging.high).is_tighter
    named = result(tmp_path, f'method = "rigorous"\n{COARSE}', noisy=True, function=gentle)
    assert named.instead == ()


@given(st.integers(100, 50_000), st.integers(1, 3))
def test_a_budget_is_divided_into_tests_of_whole_rollouts(rollouts: int, parameters: int) -> None:
    tests, replicates = division(rollouts, parameters)
    assert 0.6 * rollouts <= tests * replicates <= 1.5 * rollouts
    assert tests >= 50


@pytest.mark.rest
def test_the_file_replaces_constants_and_keeps_the_rest(tmp_path: Path) -> None:
    text = f"seed = 7\nalpha = 0.2\nrkhs_norm = 99\nkernel = {{ length_scale = 9.0 }}\nmax_tests = 7\n{HEAD}"
    found = result(tmp_path, text, noisy=False)
    assert found.text is not None
    config = parse_campaign(found.text.encode(), "c.toml")
    problem = config.problems[0]
    assert isinstance(problem, RigorousProblem)
    assert (config.seed, problem.alpha) == (7, 0.2)
    assert problem.rkhs_norm < 99
    assert config.max_tests != 7
    assert "From the file." in found.text


@pytest.mark.rest
def test_a_jump_gives_a_campaign_of_drawn_starts_with_the_evidence(tmp_path: Path) -> None:
    found = result(tmp_path, HEAD, noisy=False, function=lambda z: function(z) - (z[:, 0] > 4.6))
    assert not found.trusted
    assert "jumps" in found.problems[0].doubts[0]
    assert found.text is not None
    config = parse_campaign(found.text.encode(), "c.toml")
    assert config.problems[0].method == "sample"
    assert "rkhs_norm" not in found.text


@pytest.mark.rest
def test_values_that_a_budget_repeats_replace_the_doubted_ones(tmp_path: Path) -> None:
    measured = result(tmp_path, f"clip = [-1, 3]\n{HEAD}", noisy=True).problems[0].measured
    assert len(measured.again) == DOUBTED
    for start, mean in measured.again.items():
        assert measured.data.values[start] == mean != measured.values[start].mean()


def test_the_constants_of_a_risk_are_those_of_the_worst_starts() -> None:
    rng = np.random.default_rng(0)
    means = np.linspace(0.2, 1.0, 200)
    found = linearised_constants(means[:, None], means[:, None] + 0.05 * rng.standard_normal((200, 2)))
    assert isinstance(found.value, dict)
    assert found.value["centre"] == pytest.approx(0.22, abs=0.03)
    assert 0.03 < found.value["spread"] < 0.12


# Files


def constants(*keys: str) -> Sequence[Constant]:
    return [Constant(key, 2.0, f"Reason of {key}.", "factor 2") for key in keys]


def test_problems_keep_their_places() -> None:
    draft = {
        "name": "two",
        "gap": {"kind": "robustness"},
        "system": {"name": "segway"},
        "space": {"x": [0, 5]},
        "problems": [{"name": "nominal_robustness", "rkhs_norm": 1.0}, {"name": "sim_gap", "max_tests": 4}],
    }
    text = kernel_file(without_keys(draft, "max_tests"), [constants("rkhs_norm"), constants("alpha")], None, "Head.")
    assert text == (
        '# Head.\n\nname = "two"\ngap = { kind = "robustness" }\n\nsystem.name = "segway"\n\nspace.x = [0, 5]\n\n'
        '[[problems]]\nname = "nominal_robustness"\n# Reason of rkhs_norm. Margin: factor 2.\nrkhs_norm = 2.0\n\n'
        '[[problems]]\nname = "sim_gap"\n# Reason of alpha. Margin: factor 2.\nalpha = 2.0\n'
    )


def test_a_campaign_of_drawn_starts_keeps_what_it_can_use() -> None:
    draft = {
        "seed": 4,
        "clip": [-1, 2],
        "rkhs_norm": 3.0,
        "resolution": 9,
        "system": {"name": "s"},
        "space": {"x": [0, 1]},
    }
    text = sample_file({**draft, "specification": "x >= 0"}, (-1, 2), 0.001, ["It jumps."])
    assert "It jumps." in text
    config = parse_campaign(text.encode(), "c.toml")
    assert (config.seed, config.clip, config.problems[0].method) == (4, (-1, 2), "sample")
    assert len(config.claims) == 3


def test_the_plan_of_a_draft_has_no_limit_for_noise(tmp_path: Path) -> None:
    draft = read(tmp_path, HEAD)
    plan = plans.plan(draft.config, spec(noisy=True), draft.config.problems[0])
    assert plan.hoeffding >= 1e99
    assert json.dumps(plan.clip) == json.dumps(list(CLIP))


@pytest.mark.rest
def test_falls_that_no_standard_deviation_bounds_take_their_scale_from_the_clip(tmp_path: Path) -> None:
    text = f"clip = [-30, 3]\n{HEAD}"
    measured = result(tmp_path, text, noisy=True).problems[0].measured
    values = measured.values.copy()
    values[7, 1] -= 20.0
    # The start was simulated again, and its mean is that of the fresh rollouts.
    fell = replace(measured, values=values, again={**measured.again, 7: float(measured.values[7].mean())})
    (plain,) = (each for each in calibrated(measured, {}, ()).constants if each.key == "noise_scale")
    (falling,) = (each for each in calibrated(fell, {}, ()).constants if each.key == "noise_scale")
    assert isinstance(plain.value, float)
    assert falling.value == "derived"
    assert "no multiple of one bounds such falls. R = " in falling.reason


@pytest.mark.rest
def test_a_plan_that_proves_nothing_names_the_other_method(tmp_path: Path) -> None:
    (guess,) = result(tmp_path, f'method = "kriging"\n{COARSE}', noisy=True, function=gentle).forecasts
    assert isinstance(guess, BudgetForecast)
    assert not guess.vain
    vain = replace(guess, without=guess.proposed.bound.middle)
    assert vain.vain
    assert "method rigorous may prove more" in vain.reason
