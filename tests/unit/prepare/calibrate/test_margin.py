"""What a campaign file requires, in terms of the objective of a calibration."""

import pytest

from perfbound.orchestrator.prepare.calibrate.constants import forecast_margin_words, required_objective
from perfbound.schemas.file.config import CampaignConfig
from tests.facts import says
from tests.fakes.simulators import robustness

PAPER = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


def campaign(margin: float) -> CampaignConfig:
    return robustness(PAPER, required_margin=margin)


def test_a_margin_is_minus_the_objective() -> None:
    config = campaign(0.3)
    assert required_objective(config, config.problems[0]) == -0.3


def test_several_problems_have_no_objective_of_their_own() -> None:
    config = campaign(0.3)
    pair = config.model_copy(update={"problems": (*config.problems, *config.problems)})
    assert required_objective(pair, config.problems[0]) is None
    assert forecast_margin_words(pair, config.problems[0], -0.4, -0.5) == ""


@pytest.mark.parametrize(
    ("margin", "words"),
    [
        (0.3, "0.4 least 0.3 required"),
        (0.45, "0.4 least 0.45 required: smaller"),
        (0.6, "0.4 least 0.6 required"),
    ],
)
def test_a_forecast_bound_is_compared_with_what_is_required(margin: float, words: str) -> None:
    config = campaign(margin)
    found = forecast_margin_words(config, config.problems[0], expected=-0.4, worst=-0.5)
    assert says(found, words)
    assert ("smaller alpha" in found) == (margin == 0.45)
    assert found.endswith("is required") == (margin == 0.3)
