"""Stored rollouts under another formula."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.report.score import BARS, ScoredRollout, bars, score_lines, scored
from perfbound.schemas.errors import EvidenceError, PerfboundError
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import robustness, simulate

RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


def slope(request: RolloutRequest) -> float:
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("score") / "run"
    assert simulate(found, robustness(RIGOROUS, spot_check=10, recheck=3), slope, noisy=False)
    return found


def score(directory: Path, formula: str) -> list[ScoredRollout]:
    return scored(directory, formula, lambda *_: None)


def test_another_formula_has_its_own_robustness(campaign: Path) -> None:
    same, lower = score(campaign, "value >= 0"), score(campaign, "value >= 0.4")
    assert not [each for each in same if "recheck" in each.rollout], "it repeats others"
    assert [each.rollout for each in same] == [each.rollout for each in lower]
    shifts = {round(a.robustness - b.robustness, 12) for a, b in zip(same, lower, strict=True)}
    assert shifts == {0.4}
    assert {each.robustness < 0 for each in lower} == {True, False}


def test_the_text_says_that_nothing_is_certified_and_names_the_worst(campaign: Path) -> None:
    found = score(campaign, "value >= 0.4")
    first, _, count, *others = score_lines(campaign, "value >= 0.4", found)
    assert says(first, "^EXPLORATORY: rollouts nothing")
    below = sum(each.robustness < 0 for each in found)
    assert count == f"nominal: {below} of {len(found)} rollouts violate it"
    worst = min(found, key=lambda each: each.robustness)
    assert any(worst.rollout in line and "z1 = 1, z2 = 1" in line for line in others)


@pytest.mark.parametrize(
    ("formula", "part"), [("value >=", "--specification: "), ("valu >= 0", "did you mean 'value'")]
)
def test_a_wrong_formula_is_one_line(campaign: Path, formula: str, part: str) -> None:
    with pytest.raises(PerfboundError) as caught:
        score(campaign, formula)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_changed_file_is_not_scored(campaign: Path) -> None:
    path = next(campaign.glob("trajectories/robustness/**/*.mcap"))
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    with pytest.raises(EvidenceError):
        score(campaign, "value >= 0")
    path.write_bytes(data)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_every_value_is_in_one_bar_and_none_has_both_signs(values: list[float]) -> None:
    lines = list(bars(values))
    assert len(lines) <= BARS + 2
    assert sum(int(line.split()[3].replace(",", "")) for line in lines) == len(values)
