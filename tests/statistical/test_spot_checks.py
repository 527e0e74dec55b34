"""The study of silent claims, on one function of each family, and on three of each where time does not count."""

import pytest

from tests.studies.coverage.spot_checks import FAMILIES, OBSERVED, campaigns
from tests.studies.coverage.spot_page import BINS, is_silent, numbers, tables


@pytest.mark.parametrize("rounds", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_no_claim_that_is_false_on_two_percent_of_the_box_is_silent(rounds: int) -> None:
    found = [each for number in range(rounds * len(FAMILIES)) for each in campaigns(number)]
    assert {each.family for each in found} == set(FAMILIES)
    assert {each.observed for each in found} == {each.name for each in OBSERVED}
    false = [each for each in found if each.share >= BINS[0][0]]
    assert any(not each.refuted for each in false), "some claims are false and pass the audit of the method"
    assert not any(map(is_silent, false))
    assert not [each for each in found if each.factor == 1 and each.family == "GP draws" and each.any_share > 0]
    assert f"{len(found) // 12} functions" in tables(numbers(found))
