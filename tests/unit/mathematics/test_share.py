"""Shares of a distribution of starts: Clopper-Pearson against exact arithmetic."""

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.share import clopper_pearson_upper


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
