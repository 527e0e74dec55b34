"""The test of the opposite of a claim."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.checks.counter_evidence import AT_ONCE, CAP, OppositeTest
from perfbound.orchestrator.mathematics.bounds.rounding import RICHEST


def test_a_mean_below_the_limit_is_found() -> None:
    rng, test = np.random.default_rng(1), OppositeTest(0.0, -2.0, 2.0)
    for number in range(600):
        start = number % 3
        test.observe(start, float(np.clip((-0.3 if start == 1 else 0.1) + 0.5 * rng.standard_normal(), -2, 2)))
    assert test.wealth > 1000


def test_values_above_the_limit_cost_wealth() -> None:
    test = OppositeTest(0.0, -1.0, 1.0)
    for _ in range(50):
        test.observe("a start", 0.5)
    assert test.wealth < 0.8


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(-1, 1)), max_size=60), st.floats(-0.99, 0.99))
def test_no_value_costs_more_than_its_share(values: list[tuple[int, float]], limit: float) -> None:
    test, before = OppositeTest(limit, -1.0, 1.0), 1.0
    for start, value in values:
        test.observe(start, value)
        assert test.wealth >= before * (1.0 - CAP) * (1 - 1e-12)
        before = test.wealth


@pytest.mark.parametrize("skewed", [0.02, 0.5, 0.9])
def test_it_is_a_martingale_where_every_mean_is_the_limit(skewed: float) -> None:
    """Two-point values at adaptively chosen starts: the wealth has mean 1, and passes 20 in at most a twentieth."""
    rng, limit = np.random.default_rng(7), 0.3
    low, high = 0.0, limit / skewed if skewed > limit else 1.0
    chance = limit / high
    ends, largest = [], []
    for _ in range(4000):
        test, most, start = OppositeTest(limit, low, high + 0.1), 1.0, 0
        for _ in range(40):
            value = high if rng.random() < chance else low
            test.observe(start, value)
            most = max(most, test.wealth)
            start = start if value < limit else start + 1  # stays where it looks bad
        ends.append(test.wealth)
        largest.append(most)
    error = np.std(ends) / np.sqrt(len(ends))
    assert abs(np.mean(ends) - 1.0) <= 4 * error
    assert np.mean(np.array(largest) >= 20.0) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(largest))


@pytest.mark.parametrize("limit", [-2.0, 1.0, float("nan")])
def test_a_limit_outside_the_range_is_refused(limit: float) -> None:
    with pytest.raises(ValueError, match="must be in"):
        OppositeTest(limit, -1.0, 1.0)


def test_a_value_outside_the_range_is_refused() -> None:
    with pytest.raises(ValueError, match="a value must be in"):
        OppositeTest(0.0, -1.0, 1.0).observe(0, 1.5)


def check_pieces(values: np.ndarray, limit: float, sizes: list[int]) -> OppositeTest:
    """Check that values one by one and in pieces at two starts leave the same state, to the bit; return the test."""
    one, many = OppositeTest(limit, -1.0, 1.0), OppositeTest(limit, -1.0, 1.0)
    for number, piece in enumerate(np.split(values, np.cumsum(sizes))):
        for value in piece.tolist():
            one.observe(number % 2, value)
        many.observe_each(number % 2, piece.tolist())
    assert one == many
    return many


@given(
    st.lists(st.one_of(st.floats(-1, 1), st.sampled_from([-1.0, 1.0])), max_size=100),
    st.floats(-0.99, 0.99),
    st.lists(st.integers(0, 40), max_size=4),
)
def test_pieces_are_what_one_by_one_is(values: list[float], limit: float, sizes: list[int]) -> None:
    check_pieces(np.array(values), limit, sizes)


def test_it_is_the_same_where_wealth_is_discarded() -> None:
    rng = np.random.default_rng(8)
    values = np.concatenate([np.full(2000, -0.9), rng.uniform(-1, 1, 3 * AT_ONCE), np.full(200, 1.0)])
    test = check_pieces(values[:2000], 0.5, [900, 1])
    assert max(test._wealth) == RICHEST
    check_pieces(values, 0.5, [1200, 500, 3, AT_ONCE + 1])


@pytest.mark.parametrize("tiny", [1e-162, 1e-200])
def test_squares_that_are_too_small_for_a_double_suggest_nothing(tiny: float) -> None:
    test = check_pieces(np.repeat([-tiny, 0.0, 0.0, -0.5], 50), 0.0, [50, 0, 60])
    assert test.wealth >= 1.0


def test_nothing_changes_where_one_of_many_values_is_outside() -> None:
    test = OppositeTest(0.0, -1.0, 1.0)
    with pytest.raises(ValueError, match=r"not 1\.5"):
        test.observe_each(0, [0.5, 1.5, math.nan])
    assert test == OppositeTest(0.0, -1.0, 1.0)
