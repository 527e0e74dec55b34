"""What the clip alone proves of every objective."""

import math
from typing import Any

import pytest

from perfbound.orchestrator.campaign.checks import check, check_new
from perfbound.orchestrator.campaign.clip import by_clip, floored, is_vacuous, least_risk, of_drawn_starts
from perfbound.orchestrator.mathematics.bounds.one_law.risk import bhatia_davis
from perfbound.orchestrator.mathematics.bounds.rounding import round_down
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.drawn_claims import ClaimRequest
from perfbound.schemas.file.problem_models import Gap
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.campaigns import config
from tests.facts import facts
from tests.fakes.finished import a_pair


@pytest.mark.parametrize(
    ("campaign", "wanted"),
    [
        ("segway-paper", [-0.05, None]),  # the paper does not clip its gap
        ("segway-pair", [-0.05, 0.8]),
        ("segway-scenario", [-0.057921562]),
        ("segway-direct", [-0.057921562]),
        ("test-function", [None]),
    ],
)
def test_every_problem(campaign: str, wanted: list[float | None]) -> None:
    found = config(campaign)
    assert [by_clip(found, problem) for problem in found.problems] == wanted


def test_a_gap_in_the_unit_of_the_signal() -> None:
    found = config("segway-pair")
    gap = Gap(kind="signal_sup", column="phi", lipschitz=4.0)
    assert by_clip(found, found.problems[1].model_copy(update={"gap": gap})) == 0.2


@pytest.mark.parametrize("changes", [{"risk_weight": 0.5}, {"clip": [0.0, 3.0]}, {"clip": [-2.0, -1.5]}])
def test_no_law_on_the_clip_has_a_lower_risk(changes: dict[str, Any]) -> None:
    found = config("segway-scenario", **changes)
    assert found.clip is not None
    (low, high), least = found.clip, least_risk(found)
    assert least is not None
    # Two points, low and high, have the largest deviation of all laws with their mean.
    for k in range(1001):
        share = k / 1000
        mean, sd = low + share * (high - low), math.sqrt(share * (1 - share)) * (high - low)
        assert least <= mean - found.risk_weight * sd
    assert least == pytest.approx(bhatia_davis(low, found.clip, found.risk_weight), abs=2e-9)


def test_of_drawn_starts_the_clip_alone_proves_its_lower_end_and_without_a_clip_there_is_no_limit() -> None:
    clipped = config("segway-scenario")
    unclipped = clipped.model_copy(update={"clip": None})
    mean, share, risk = (ClaimRequest(quantity=each) for each in ("mean", "failure_probability", "risk"))
    assert clipped.clip is not None
    low = round_down(clipped.clip[0])
    assert [of_drawn_starts(clipped, each) for each in (mean, share, risk)] == [low, 1.0, least_risk(clipped)]
    assert [of_drawn_starts(unclipped, each) for each in (mean, share, risk)] == [None, 1.0, None]
    assert (floored(low - 1.0, ">=", low), floored(low - 1.0, ">=", None)) == (low, low - 1.0)
    assert (is_vacuous(low, ">=", low), is_vacuous(low, ">=", None)) == (True, False)


@pytest.mark.parametrize("low", [0.0, 0.5])
def test_a_clip_that_hides_violations_is_refused_for_new_campaigns(low: float) -> None:
    spec, pair = TestFunctionSystem().spec, a_pair("rigorous")
    campaign = pair.model_copy(update={"clip": (low, 0.75)})
    with pytest.raises(CampaignError, match=facts("here: clip: lower")):
        check_new(campaign, spec, "here")
    check(campaign, spec, "here")
    check_new(pair, spec, "here")
