"""The study of campaigns with constants from a calibration alone, on one function of each family, or on six."""

from pathlib import Path

import pytest

from tests.studies.coverage.calibration import outcome
from tests.studies.coverage.spot_checks import FAMILIES, OBSERVED, Observed


@pytest.mark.parametrize("observed", OBSERVED[:2], ids=["exact", "mean"])
@pytest.mark.parametrize("rounds", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_no_campaign_is_false_and_silent_on_one_percent_of_the_box(
    tmp_path: Path, rounds: int, observed: Observed
) -> None:
    found = [outcome(number, observed, tmp_path) for number in range(rounds * len(FAMILIES))]
    assert {each.family for each in found} == set(FAMILIES)
    assert not [each for each in found if each.silent and each.share >= 0.01]
    # Nor by refusing every kernel.
    assert not [each for each in found if each.family in {"GP draws", "kinks"} and each.doubts]
    assert [each for each in found if each.family in {"jumps", "narrow holes"} and each.doubts]
    if not observed.noisy:
        assert all(each.doubts for each in found if each.family in {"jumps", "narrow holes", "high frequency", "flat"})
        assert all(each.ratio >= 1 for each in found if each.family == "GP draws")
