"""The lower bound from weighted samples: its scale, its order, and what it refuses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law.share import clopper_pearson_lower
from perfbound.orchestrator.mathematics.bounds.one_law.weighted import (
    DEFENSIVE,
    importance_weight,
    weighted_failure_lower,
)

DELTA = 0.05
WEIGHTS = st.lists(st.floats(1e-9, 10.0), min_size=1, max_size=30)


@given(WEIGHTS, st.integers(0, 50))
def test_it_is_below_the_mean_and_needs_no_order(weights: list[float], passed: int) -> None:
    count = len(weights) + passed
    found = weighted_failure_lower(weights, count, DELTA)
    assert 0.0 < found < sum(weights) / count
    assert found <= 1.0
    assert weighted_failure_lower(weights[::-1], count, DELTA) == pytest.approx(found, rel=2e-6)


@given(WEIGHTS, st.integers(0, 50), st.integers(0, 29))
def test_more_failures_raise_it_and_more_passes_lower_it(weights: list[float], passed: int, place: int) -> None:
    count = len(weights) + passed
    found = weighted_failure_lower(weights, count, DELTA)
    larger = list(weights)
    larger[place % len(weights)] *= 2.0
    assert weighted_failure_lower(larger, count, DELTA) >= found
    assert weighted_failure_lower(weights, count + 1, DELTA) <= found


@given(WEIGHTS, st.integers(0, 50), st.integers(1, 60))
def test_it_scales_with_the_weights(weights: list[float], passed: int, halvings: int) -> None:
    count, scale = len(weights) + passed, 0.5**halvings
    found = weighted_failure_lower(weights, count, DELTA)
    scaled = weighted_failure_lower([scale * each for each in weights], count, DELTA)
    assert found == 1.0 or scaled == pytest.approx(scale * found, rel=2e-5)


def test_of_samples_as_in_operation_it_is_near_the_exact_bound_of_a_count() -> None:
    exact = clopper_pearson_lower(100, 200, DELTA)
    assert 0.85 * exact < weighted_failure_lower([1.0] * 100, 200, DELTA) < exact


def test_without_a_failure_it_is_zero() -> None:
    assert weighted_failure_lower([], 200, DELTA) == weighted_failure_lower([0.0] * 200, 200, DELTA) == 0.0


def test_weights_below_all_doubles_of_a_product_are_no_error() -> None:
    assert 0.0 < weighted_failure_lower([1e-290] * 100, 200, DELTA) < 1e-290
    assert weighted_failure_lower([5e-324], 100_000, DELTA) == 0.0


@pytest.mark.parametrize(
    ("weights", "count", "delta"),
    [([-1.0], 2, 0.05), ([math.nan], 2, 0.05), ([math.inf], 2, 0.05), ([1.0, 1.0], 1, 0.05), ([1.0], 2, 1.0)],
)
def test_it_refuses_what_is_no_weight(weights: list[float], count: int, delta: float) -> None:
    with pytest.raises(ValueError, match="needs weights"):
        weighted_failure_lower(weights, count, delta)


def test_a_weight_is_the_ratio_of_the_densities() -> None:
    centre, scores = np.array([3.0, -1.0]), np.array([2.5, 0.5])
    operation = math.exp(-scores @ scores / 2)
    around = math.exp(-(scores - centre) @ (scores - centre) / 2)
    expected = operation / (DEFENSIVE * operation + (1 - DEFENSIVE) * around)
    assert importance_weight(scores.tolist(), centre.tolist()) == pytest.approx(expected, rel=1e-12)
    assert importance_weight((8.0,) * 64, (8.0,) * 64) == 0.0
    assert importance_weight((-8.0,) * 64, (8.0,) * 64) == pytest.approx(1 / DEFENSIVE)
