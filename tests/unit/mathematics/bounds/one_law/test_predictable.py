"""CVaR, risk and mean with parameters from the past, against exact small cases."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law.predictable import (
    Choice,
    CvarSequence,
    PredictableSequence,
    RiskSequence,
    best_expected,
    sample_quantile,
)


def risk_of(values: list[float], risk_weight: float = 0.5, delta: float = 0.05) -> RiskSequence:
    bound = RiskSequence(risk_weight, (0.0, 1.0), delta=delta)
    for value in values:
        bound.add(value)
    return bound


CHOICES = [best_expected, sample_quantile]


def of(values: list[float], share: float = 0.25, delta: float = 0.05, choice: Choice = best_expected) -> CvarSequence:
    bound = CvarSequence(share, (0.0, 1.0), delta=delta, choice=choice)
    for value in values:
        bound.add(value)
    return bound


class TestCvar:
    @pytest.mark.parametrize("choice", CHOICES)
    @pytest.mark.parametrize("p", [0.25, 0.5])
    def test_the_exact_failure_probability_is_below_delta(self, p: float, choice: Choice) -> None:
        """Every path of 8 two-point values with the bad one at .2: CVaR_(1/4) is .2, as p >= 1/4."""
        failure = 0.0
        for path in itertools.product((0, 1), repeat=8):
            bound, wrong = CvarSequence(0.25, (0.0, 1.0), delta=0.3, choice=choice), False
            for bad in path:
                bound.add(0.2 if bad else 1.0)
                wrong = wrong or bound.lower() > 0.2
            failure += p ** sum(path) * (1 - p) ** (8 - sum(path)) * wrong
        assert failure <= 0.3

    @pytest.mark.parametrize("choice", CHOICES)
    @pytest.mark.parametrize("p", [0.25, 0.5])
    def test_the_mean_wealth_is_at_most_one_from_the_truth_on(self, p: float, choice: Choice) -> None:
        total = np.zeros(4096)
        for path in itertools.product((0, 1), repeat=8):
            bound = of([0.2 if bad else 1.0 for bad in path], delta=1e-299, choice=choice)
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
        for bound in (of(values), of(values, choice=sample_quantile), of(values, share=1.0), risk_of(values)):
            self.check_moments(bound, values)

    @staticmethod
    def check_moments(bound: PredictableSequence, values: list[float]) -> None:
        x = [bound._read(value) for value in values]
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
            lambda: CvarSequence(0.0, (0.0, 1.0), delta=0.05),
            lambda: CvarSequence(1.5, (0.0, 1.0), delta=0.05),
            lambda: CvarSequence(0.1, (0.0, 1.0), delta=1.0),
            lambda: CvarSequence(0.1, (1.0, 1.0), delta=0.05),
            lambda: of([1.5]),
            lambda: of([math.nan]),
        ],
    )
    def test_bad_input(self, call: Callable[[], object]) -> None:
        with pytest.raises(ValueError, match=r"must|clip"):
            call()


class TestChoice:
    @given(st.lists(st.floats(-0.5, 1), min_size=1, max_size=60), st.sampled_from([0.05, 0.3, 0.9]))
    @settings(max_examples=50, deadline=None)
    def test_every_choice_is_a_value(self, values: list[float], share: float) -> None:
        for choice in CHOICES:
            assert 0 <= choice(sorted(values), share, -0.5, 0.05) < len(values)

    def test_at_a_jump_of_the_quantile_it_stays_where_x_does_not_vary(self) -> None:
        """Nine or eleven of a hundred are bad: t is the bad value, while the sample quantile jumps."""
        found = [[0.2] * bad + [0.9] * (100 - bad) for bad in (9, 11)]
        assert [values[best_expected(values, 0.1, 0.0, 0.05)] for values in found] == [0.2, 0.2]
        assert [values[sample_quantile(values, 0.1, 0.0, 0.05)] for values in found] == [0.9, 0.2]

    def test_the_bound_of_the_sample_quantile(self) -> None:
        values = [0.6 + 0.001 * (j * 37 % 100) for j in range(400)]
        assert of(values, 0.1, choice=sample_quantile).lower() == 0.55493164

    def test_the_whole_share_is_the_mean(self) -> None:
        values = np.random.default_rng(1).beta(5, 2, 400).tolist()
        assert of(values, 1.0).lower() == pytest.approx(risk_of(values, 0.0).lower(), abs=0.01)


class TestRisk:
    @pytest.mark.parametrize("risk_weight", [0.0, 0.5, 2.0])
    @pytest.mark.parametrize("p", [0.1, 0.5])
    def test_the_exact_failure_probability_and_the_mean_wealth(self, p: float, risk_weight: float) -> None:
        """Every path of 8 two-point values .2 and .9."""
        risk = 0.9 - 0.7 * p - risk_weight * 0.7 * math.sqrt(p * (1 - p))
        failure, total = 0.0, np.zeros(4096)
        for path in itertools.product((0, 1), repeat=8):
            bound = RiskSequence(risk_weight, (0.0, 1.0), delta=0.3)
            wrong, chance = False, p ** sum(path) * (1 - p) ** (8 - sum(path))
            for bad in path:
                bound.add(0.2 if bad else 0.9)
                wrong = wrong or bound.lower() > risk
            failure += chance * wrong
            free = risk_of([0.2 if bad else 0.9 for bad in path], risk_weight, delta=1e-299)
            assert (free._wealth > 0).all()
            total += chance * free._wealth.sum(axis=0)
        assert failure <= 0.3
        assert (total[free._candidates >= risk] <= 1 + 1e-12).all()

    @given(st.lists(st.floats(0, 1), max_size=40), st.sampled_from([0.0, 0.2, 1.0]))
    @settings(max_examples=30, deadline=None)
    def test_the_bound_never_falls_and_no_factor_is_negative(self, values: list[float], risk_weight: float) -> None:
        bound = risk_of([], risk_weight)
        last = bound.lower()
        for value in values:
            bound.add(value)
            assert last <= bound.lower() <= 1.0
            assert (bound._wealth > 0).all()
            last = bound.lower()

    def test_the_least_value_is_the_least_risk_of_a_law_on_the_clip(self) -> None:
        """Half on each end with r = 1 is not the least one: E - sd is least where the good end is rarer."""
        chances = np.linspace(0, 1, 10_001)
        least = (chances - np.sqrt(chances * (1 - chances))).min()
        assert risk_of([], 1.0).lower() == pytest.approx(least, abs=1e-6)
        assert risk_of([], 1.0).lower() <= least

    def test_constant_values_lead_to_the_constant(self) -> None:
        found = [risk_of([0.5] * n, 0.2).lower() for n in (100, 1000, 4000)]
        assert found == sorted(found)
        assert 0.49 < found[-1] <= 0.5

    def test_more_weight_has_a_lower_bound(self) -> None:
        values = np.random.default_rng(0).uniform(0.3, 0.9, 500).tolist()
        found = [risk_of(values, weight).lower() for weight in (0.0, 0.2, 1.0)]
        assert found == sorted(found, reverse=True)

    @pytest.mark.parametrize(
        "call",
        [
            lambda: RiskSequence(-0.1, (0.0, 1.0), delta=0.05),
            lambda: RiskSequence(0.2, (0.0, math.inf), delta=0.05),
            lambda: RiskSequence(0.2, (0.0, 1.0), delta=0.0),
            lambda: risk_of([-0.1]),
        ],
    )
    def test_bad_input(self, call: Callable[[], object]) -> None:
        with pytest.raises(ValueError, match=r"must|clip"):
            call()
