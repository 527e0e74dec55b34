"""Shares of a distribution for a number of samples that is fixed beforehand, against exact small cases."""

import itertools
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law.share import (
    clopper_pearson_lower,
    clopper_pearson_upper,
    next_rollout_probability,
    next_rollout_rank,
    quantile_lower,
    quantile_rank,
    ranked,
    shifted_failure_upper,
    shifted_share,
)


def at_most(failures: int, count: int, p: Fraction) -> Fraction:
    """Return P[Bin(count, p) <= failures], exactly."""
    return sum((math.comb(count, i) * p**i * (1 - p) ** (count - i) for i in range(failures + 1)), Fraction(0))


class TestClopperPearson:
    @given(st.integers(1, 40), st.floats(0, 1), st.sampled_from([0.05, 0.01, 0.5]))
    @settings(max_examples=50, deadline=None)
    def test_it_is_the_exact_bound_rounded_up(self, count: int, part: float, delta: float) -> None:
        failures = int(part * (count - 1))
        p = Fraction(repr(clopper_pearson_upper(failures, count, delta)))
        assert at_most(failures, count, p) <= Fraction(repr(delta))
        if p < 1:
            assert at_most(failures, count, p - Fraction(3, 10**9)) > Fraction(repr(delta))

    @pytest.mark.parametrize(("count", "percent"), [(299, 1e-2), (29_956, 1e-4), (299_572, 1e-5)])
    def test_the_failure_free_counts_of_the_theory(self, count: int, percent: float) -> None:
        assert clopper_pearson_upper(0, count, 0.05) <= percent < clopper_pearson_upper(0, count - 2, 0.05)

    def test_all_failed(self) -> None:
        assert clopper_pearson_upper(5, 5, 0.05) == 1.0

    @given(st.integers(1, 40), st.floats(0, 1), st.sampled_from([0.05, 0.01, 0.5]))
    @settings(max_examples=50, deadline=None)
    def test_the_lower_one_is_exact_and_rounded_down(self, count: int, part: float, delta: float) -> None:
        failures = 1 + int(part * (count - 1))
        p = Fraction(repr(clopper_pearson_lower(failures, count, delta)))
        assert 1 - at_most(failures - 1, count, p) <= Fraction(repr(delta))
        assert 1 - at_most(failures - 1, count, p + Fraction(3, 10**9)) > Fraction(repr(delta))

    @given(st.integers(1, 300), st.floats(0, 1))
    @settings(max_examples=50, deadline=None)
    def test_failures_and_successes_change_places(self, count: int, part: float) -> None:
        failures = int(part * count)
        lower, upper = (
            clopper_pearson_lower(failures, count, 0.05),
            clopper_pearson_upper(count - failures, count, 0.05),
        )
        assert lower == pytest.approx(1 - upper, abs=3e-9)

    @pytest.mark.parametrize("given", [(-1, 5, 0.05), (6, 5, 0.05), (0, 0, 0.05), (0, 5, 0.0), (0, 5, 1.0)])
    @pytest.mark.parametrize("bound", [clopper_pearson_lower, clopper_pearson_upper])
    def test_bad_input(self, bound: Callable[..., float], given: tuple[int, int, float]) -> None:
        with pytest.raises(ValueError, match="must be"):
            bound(*given)


class TestQuantile:
    @given(st.integers(1, 60), st.sampled_from([0.1, 0.25, 0.5]), st.sampled_from([0.05, 0.2]))
    @settings(max_examples=50, deadline=None)
    def test_the_rank_is_the_largest_that_holds(self, count: int, share: float, delta: float) -> None:
        rank = quantile_rank(count, share, delta)
        q, level = Fraction(repr(share)), Fraction(repr(delta))
        assert rank is None or at_most(rank - 1, count, q) <= level
        assert at_most(rank or 0, count, q) > level * (1 - Fraction(1, 10**11))

    @pytest.mark.parametrize("given", [(0, 0.1, 0.05), (9, 0.0, 0.05), (9, 0.1, 1.0)])
    def test_bad_input(self, given: tuple[int, float, float]) -> None:
        with pytest.raises(ValueError, match="must be"):
            quantile_rank(*given)


class TestNextRollout:
    @given(st.integers(1, 500), st.floats(0.001, 0.999))
    def test_the_rank_is_the_largest_that_holds(self, count: int, delta: float) -> None:
        rank, level = next_rollout_rank(count, delta), Fraction(repr(delta))
        assert Fraction(rank or 0, count + 1) <= level < Fraction((rank or 0) + 1, count + 1)

    @pytest.mark.parametrize("atoms", [(0, 1, 2, 3), (0, 0, 1, 1), (0, 1)])
    def test_the_exact_probability_over_all_draws(self, atoms: tuple[int, ...]) -> None:
        """Five values and the next one, ties included: equality without ties alone."""
        for rank in range(1, 6):
            draws = list(itertools.product(atoms, repeat=6))
            share = Fraction(sum(next_one >= sorted(first)[rank - 1] for *first, next_one in draws), len(draws))
            assert share >= Fraction(repr(next_rollout_probability(rank, 5)))

    def test_without_ties_it_is_exact(self) -> None:
        draws = list(itertools.permutations(range(6)))
        for rank in range(1, 6):
            share = Fraction(sum(next_one >= sorted(first)[rank - 1] for *first, next_one in draws), len(draws))
            assert share == 1 - Fraction(rank, 6)
            assert 0 <= share - Fraction(repr(next_rollout_probability(rank, 5))) <= Fraction(1, 10**9)

    def test_bad_input(self) -> None:
        for rank in (0, 6):
            with pytest.raises(ValueError, match="must be"):
                next_rollout_probability(rank, 5)
        with pytest.raises(ValueError, match="must be"):
            next_rollout_rank(0, 0.05)


class TestShift:
    @given(
        st.lists(st.tuples(st.floats(0, 1), st.floats(0.01, 1), st.floats(0, 1)), min_size=1, max_size=8),
        st.floats(1, 20),
    )
    def test_every_shifted_law_keeps_both_bounds(self, law: list[tuple[float, float, float]], ratio: float) -> None:
        """A density between 0 and Lambda on finitely many starts; a start fails if its value is below 1/2."""
        values, weights = (np.array(each) for each in zip(*((v, w) for v, w, _ in law), strict=True))
        weights = weights / weights.sum()
        density = np.array([tilt for *_, tilt in law]) + 1e-9
        density = np.minimum(density / (weights @ density), ratio)
        density += (ratio - density) * (1 - weights @ density) / max(ratio - weights @ density, 1e-12)
        shifted = weights * density
        q = shifted_share(ratio)
        cvar = max(t - weights @ np.maximum(t - values, 0) / q for t in values)
        assert shifted @ values >= cvar - 1e-9
        bad = values < 0.5
        assert shifted[bad].sum() <= shifted_failure_upper(min(float(weights[bad].sum()), 1.0), ratio) + 1e-9

    @given(st.floats(1, 1e6))
    @example(593359.6843079301)  # the quotient and the double below it are too large
    def test_the_share_is_not_above_the_inverse(self, ratio: float) -> None:
        assert Fraction(shifted_share(ratio)) * Fraction(repr(ratio)) <= 1
        assert shifted_share(ratio) >= (1 / ratio) * (1 - 1e-15)

    def test_one_is_no_shift(self) -> None:
        assert (shifted_share(1.0), shifted_failure_upper(0.3, 1.0), shifted_failure_upper(0.3, 9.0)) == (1.0, 0.3, 1.0)

    def test_bad_input(self) -> None:
        for ratio in (0.5, math.inf, math.nan):
            with pytest.raises(ValueError, match="must be"):
                shifted_share(ratio)
        with pytest.raises(ValueError, match="must be"):
            shifted_failure_upper(1.5, 2.0)


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=50), st.data())
def test_the_ranked_value_is_that_of_the_sorted_ones(values: list[float], data: st.DataObject) -> None:
    rank = data.draw(st.integers(1, len(values)))
    assert ranked(values, rank) == sorted(values)[rank - 1]


@pytest.mark.parametrize("count", [29, 100_000])
def test_the_quantile_of_many_values_is_that_of_the_sorted_ones(count: int) -> None:
    values = np.random.default_rng(count).choice([0.25, 0.5, 0.75, 1.0], count)
    rank = quantile_rank(count, 0.1, 0.05)
    assert rank is not None
    assert quantile_lower(values.tolist(), 0.1, 0.05) == sorted(values.tolist())[rank - 1]
