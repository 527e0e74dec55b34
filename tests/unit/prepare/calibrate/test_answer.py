"""What a campaign file requires, in terms of the objective of a calibration, and the answer beside it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.prepare.calibrate.answer import Requirement, answer, compared
from perfbound.orchestrator.prepare.calibrate.budget import BudgetForecast, PlannedBudget
from perfbound.orchestrator.prepare.calibrate.calibrate import Calibration
from perfbound.orchestrator.prepare.calibrate.constants import PilotPace, required_bound, required_objective
from perfbound.orchestrator.prepare.calibrate.forecast import Forecast
from perfbound.orchestrator.prepare.calibrate.tolerance import ERRORS, ToleranceForecast
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.values import Guess
from tests.facts import says
from tests.fakes.simulators import robustness
from tests.unit.prepare.calibrate import test_constants

PAPER = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}
EFFORT = "about 1,400 rollouts (36 min 0 s on 2 workers)"


def campaign(margin: float) -> CampaignConfig:
    return robustness(PAPER, required_margin=margin)


def test_a_margin_is_minus_the_objective() -> None:
    config = campaign(0.3)
    assert required_objective(config, config.problems[0]) == required_bound(config, config.problems[0]) == -0.3


def test_several_problems_have_no_objective_of_their_own() -> None:
    config = campaign(0.3)
    pair = config.model_copy(update={"problems": (*config.problems, *config.problems)})
    assert required_objective(pair, config.problems[0]) is None
    assert required_bound(pair, config.problems[0]) is None


def tolerance(bound: float, fitted: float, error: float = 0.01) -> ToleranceForecast:
    """Return a forecast of J, here minus the robustness."""
    return ToleranceForecast(100, (0.1,), 150, 2160.0, 1400, 0.1, Guess(bound, bound, bound), fitted, error)


def budgets(*bounds: Guess, without: float = 2.0) -> BudgetForecast:
    found = tuple(PlannedBudget(50, 8 * 2**k, each, 700 * 2**k, 60.0 * 2**k) for k, each in enumerate(bounds))
    return BudgetForecast(found, found[0], found[1], without, -0.5, 0.01, -1)


NEAR = budgets(Guess(-0.4, -0.45, -0.2), Guess(-0.44, -0.46, -0.42))
CASES: list[tuple[float, Forecast, str]] = [
    (0.3, tolerance(-0.4, -0.5), f"^Can be shown: {EFFORT} for robustness >= 0.3 m; 0.4 m"),
    (
        0.45,
        tolerance(-0.4, -0.5),
        f"^Likely not proposed budget, {EFFORT}: 0.4 m, below required 0.45 m; smaller alpha",
    ),
    (0.6, tolerance(-0.4, -0.5), "^Cannot be shown any budget: fitted worst value 0.5 m, below required 0.6 m"),
    (0.0, tolerance(0.05, 0.02, 0.009), "^Cannot be shown any budget: fitted worst value -0.02 m, below required 0 m"),
    (
        0.0,
        tolerance(0.05, 0.02, 0.011),
        "^Probably cannot be shown any budget: -0.02 m, below 0 m, standard error 0.011 m",
    ),
    (0.5, tolerance(-0.499999, -0.51), "^Likely not 0.499999 m, below required 0.5 m"),
    (0.2, NEAR, f"^Can be shown: {EFFORT} for robustness >= 0.2 m; 0.4 m"),
    (0.41, NEAR, "^Likely not 0.4 m, below 0.41 m; max_tests = 50 and replicates = 16 1,400 rollouts 2 min 0 s"),
    (0.3, NEAR, "^May be shown: robustness >= 0.3 m, 0.2 to 0.45; max_tests = 50 and replicates = 16"),
    (0.45, NEAR, "^Likely not 0.4 m, below 0.45 m; 1000 further rollouts"),
    (0.45, replace(NEAR, without=-0.4), "^Likely not 0.4 m, below 0.45 m; method rigorous"),
]


@pytest.mark.parametrize(("margin", "guess", "words"), CASES)
def test_the_answer_compares_a_forecast_with_what_is_required(margin: float, guess: Forecast, words: str) -> None:
    found = compared(Requirement("robustness", -margin, -1, "m"), guess, EFFORT)
    assert says(found, words)
    assert found.startswith("Can be shown") == (guess.bound.high <= -margin)


def test_an_upper_limit_is_missed_above_it() -> None:
    found = compared(Requirement("maximum", 0.3, 1), tolerance(0.5, 0.2), EFFORT)
    assert says(found, "^Likely not 0.5, above required 0.3;")
    assert says(compared(Requirement("maximum", 0.6, 1), tolerance(0.5, 0.2), EFFORT), "^Can be shown: maximum <= 0.6;")


def found(tmp_path: Path, text: str = "", **more: Any) -> Calibration:
    result = test_constants.result(tmp_path, f"{text}{test_constants.HEAD}", noisy=False, rollouts=150, **more)
    (problem,) = result.problems
    pace = PilotPace(100, 50.0, 4)
    return replace(result, problems=(replace(problem, measured=replace(problem.measured, pace=pace)),))


def test_the_answer_names_rollouts_time_workers_and_what_it_rests_on(tmp_path: Path) -> None:
    calibrated = found(tmp_path)
    calibrated = replace(calibrated, forecasts=(tolerance(-0.1, -0.2),))
    spent = calibrated.problems[0].measured.rollouts
    assert answer(calibrated) == (
        "Can be shown: about 1,400 rollouts (36 min 0 s on 4 workers) for robustness >= 0 m; the bound would be about "
        f"0.1 m. Fitted on {spent} pilot rollouts; no proof."
    )


def test_a_rollout_below_what_is_required_is_no_fit_where_nothing_is_random(tmp_path: Path) -> None:
    calibrated = found(tmp_path, "required_margin = 0.5\n")
    seen = calibrated.problems[0].measured.largest_seen
    assert seen is not None
    assert -0.5 < seen < 0.0
    assert says(answer(calibrated), f"^Cannot be shown any budget: one of {-seen:.3g} m, below required 0.5 m")
    assert "itted" not in answer(calibrated)


def test_without_a_kernel_the_answer_is_about_drawn_starts_or_unknown(tmp_path: Path) -> None:
    calibrated = replace(found(tmp_path, "required_margin = -2\n"), forecasts=())
    assert says(answer(calibrated), "^Not for every start: kernel pilot rollouts. drawn rollouts s on 4 workers")
    assert says(answer(replace(calibrated, text=None)), "^Not known: kernel specification")


def test_all_that_alpha_leaves_may_be_on_the_side_of_the_claim(tmp_path: Path) -> None:
    (guess,) = found(tmp_path).forecasts
    assert isinstance(guess, ToleranceForecast)
    assert guess.tests is not None
    assert guess.bound.low <= guess.bound.middle
    assert guess.bound.middle < guess.fitted + guess.alpha <= guess.bound.high - ERRORS * guess.error + 1e-9
