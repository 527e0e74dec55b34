"""Shares of a distribution of starts: Clopper-Pearson, quantiles and CVaR against exact small cases."""

import itertools
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.share import (
    AllButShare,
    clopper_pearson_upper,
    quantile_rank,
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

    @pytest.mark.parametrize("given", [(-1, 5, 0.05), (6, 5, 0.05), (0, 0, 0.05), (0, 5, 0.0), (0, 5, 1.0)])
    def test_bad_input(self, given: tuple[int, int, float]) -> None:
        with pytest.raises(ValueError, match="must be"):
            clopper_pearson_upper(*given)


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


def of(values: list[float], share: float = 0.25, delta: float = 0.05) -> AllButShare:
    bound = AllButShare(share, (0.0, 1.0), delta=delta)
    for value in values:
        bound.add(value)
    return bound


class TestAllButShare:
    @pytest.mark.parametrize("p", [0.25, 0.5])
    def test_the_exact_failure_probability_is_below_delta(self, p: float) -> None:
        """Every path of 8 two-point values with the bad one at .2: CVaR_(1/4) is .2, as p >= 1/4."""
        failure = 0.0
        for path in itertools.product((0, 1), repeat=8):
            bound, wrong = AllButShare(0.25, (0.0, 1.0), delta=0.3), False
            for bad in path:
                bound.add(0.2 if bad else 1.0)
                wrong = wrong or bound.lower() > 0.2
            failure += p ** sum(path) * (1 - p) ** (8 - sum(path)) * wrong
        assert failure <= 0.3

    @pytest.mark.parametrize("p", [0.25, 0.5])
    def test_the_mean_wealth_is_at_most_one_from_the_truth_on(self, p: float) -> None:
        total = np.zeros(4096)
        for path in itertools.product((0, 1), repeat=8):
            bound = of([0.2 if bad else 1.0 for bad in path], delta=1e-299)
            assert (bound._wealth > 0).all()
            total += p ** sum(path) * (1 - p) ** (8 - sum(path)) * bound._wealth.sum(axis=0)
        assert (total[math.ceil(0.2 * 4096) :] <= 1 + 1e-12).all()

    @given(st.lists(st.floats(0, 1), max_size=40))
    @settings(max_examples=30, deadline=None)
    def test_the_bound_never_falls_and_stays_in_the_range(self, values: list[float]) -> None:
        bound, last = of([]), 0.0
        for value in values:
            bound.add(value)
            assert last <= bound.lower() <= 1.0
            last = bound.lower()

    @given(st.lists(st.floats(0, 1), min_size=2, max_size=60))
    @settings(max_examples=30, deadline=None)
    def test_the_moments_are_those_of_all_values_at_the_current_bar(self, values: list[float]) -> None:
        bound = of(values)
        x = [bound._shortfall(value) for value in values]
        assert bound._weight == len(values)
        assert bound._mean == pytest.approx(np.mean(x), abs=1e-9)
        assert bound._squares == pytest.approx(np.var(x) * len(x), abs=1e-9)

    def test_constant_values_lead_to_the_constant(self) -> None:
        found = [of([0.5] * n, 0.1).lower() for n in (100, 1000)]
        assert found[0] < found[1] <= 0.5
        assert found[1] > 0.48

    def test_a_smaller_share_has_a_lower_bound(self) -> None:
        values = list(np.random.default_rng(0).uniform(0.3, 0.9, 500))
        found = [of(values, share).lower() for share in (0.05, 0.1, 0.2, 0.5)]
        assert found == sorted(found)

    @pytest.mark.parametrize(
        "call",
        [
            lambda: AllButShare(0.0, (0.0, 1.0), delta=0.05),
            lambda: AllButShare(0.1, (0.0, 1.0), delta=1.0),
            lambda: AllButShare(0.1, (1.0, 1.0), delta=0.05),
            lambda: of([1.5]),
            lambda: of([math.nan]),
        ],
    )
    def test_bad_input(self, call: Callable[[], object]) -> None:
        with pytest.raises(ValueError, match=r"must|clip"):
            call()
