"""The interval of a mean, against exact small cases."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law.interval import mean_interval

ENDS = (-1.0, 1.0)


def of(values: list[float], delta: float = 0.05, about: float = 0.0) -> tuple[float, float]:
    return mean_interval(np.array(values, dtype=np.float64), ENDS, delta, about=about)


@pytest.mark.parametrize("about", [0.0, -0.4])
@pytest.mark.parametrize("p", [0.1, 0.5, 0.8])
def test_the_exact_probability_to_miss_the_mean_at_any_number_is_below_delta(p: float, about: float) -> None:
    """Every path of 9 values -1 or 1: a look after each of them."""
    missed = {"below": 0.0, "above": 0.0}
    for path in itertools.product((0, 1), repeat=9):
        lower, upper = of([2.0 * each - 1.0 for each in path], 0.6, about)
        chance = p ** sum(path) * (1 - p) ** (9 - sum(path))
        missed["below"] += chance * (lower > 2 * p - 1)
        missed["above"] += chance * (upper < 2 * p - 1)
    assert max(missed.values()) <= 0.3
    assert sum(missed.values()) > 0.0, "a bound that is never wrong is no bound of this delta"


@given(st.lists(st.floats(-1, 1), max_size=60))
@settings(max_examples=40, deadline=None)
def test_with_more_values_it_never_grows(values: list[float]) -> None:
    (first, second), (lower, upper) = of(values[: len(values) // 2]), of(values)
    assert first <= lower
    assert upper <= second


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=60))
@settings(max_examples=40, deadline=None)
def test_it_is_the_mirror_of_that_of_the_negative_values(values: list[float]) -> None:
    lower, upper = of(values)
    assert of([-value for value in values]) == (-upper, -lower)


def test_the_range_is_all_that_is_known_without_a_value_and_after_one() -> None:
    assert of([]) == of([1.0]) == ENDS


def test_a_difference_of_rare_failures_is_not_rounded_away() -> None:
    rng = np.random.default_rng(1)
    values = (rng.random(100_000) < 4e-4).astype(float)
    lower, upper = mean_interval(values, ENDS, 0.05, about=0.0)
    assert 1e-4 < lower < values.mean() < upper < 1e-3


def test_it_decides_a_fifth_of_a_standard_deviation() -> None:
    rng = np.random.default_rng(2)
    lower, upper = mean_interval(rng.normal(0.02, 0.1, 1000).clip(-1.6, 1.6), (-1.6, 1.6), 0.05, about=0.0)
    assert 0.0 < lower < 0.02 < upper < 0.05


@pytest.mark.parametrize("about", [-0.5, 0.0, 0.5])
def test_where_candidates_are_closest_is_no_guess_of_the_mean(about: float) -> None:
    values = np.random.default_rng(3).normal(0.45, 0.1, 500).clip(-1.0, 1.0)
    lower, upper = mean_interval(values, ENDS, 0.05, about=about)
    assert lower < 0.45 < upper
    assert upper - lower < 0.04


@pytest.mark.parametrize(
    ("values", "ends", "delta", "about", "reason"),
    [
        ([1.5], ENDS, 0.05, 0.0, "a value must be in"),
        ([float("nan")], ENDS, 0.05, 0.0, "a value must be in"),
        ([], (1.0, 1.0), 0.05, 1.0, "clip"),
        ([], ENDS, 0.0, 0.0, "delta must be in"),
        ([], ENDS, 0.05, 2.0, "about must be in"),
    ],
)
def test_what_has_no_bound_is_refused(
    values: list[float], ends: tuple[float, float], delta: float, about: float, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        mean_interval(np.array(values), ends, delta, about=about)
