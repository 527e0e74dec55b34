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
from tests.fakes.states import blocks, sizes, state_of


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
            assert (bound._bets.wealth > 0).all()
            total += p ** sum(path) * (1 - p) ** (8 - sum(path)) * bound._bets.wealth.sum(axis=0)
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
        x = bound._read(np.array(values))
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

    @pytest.mark.parametrize(
        ("bound", "lower", "mean", "squares"),
        [
            (CvarSequence(0.1, (0.0, 1.0), delta=0.05), 0.584472656, "0x1.35810624dd2f0p-1", "0x1.0f1a9fbe76cb8p-2"),
            (CvarSequence(1.0, (0.0, 1.0), delta=0.05), 0.646728515, "0x1.4c8b43958105ep-1", "0x1.aa9fbe76c8b89p-1"),
            (RiskSequence(0.2, (0.0, 1.0), delta=0.05), 0.636080253, "0x1.4943a861ea3fcp-1", "0x1.abe85974fe3efp-1"),
        ],
    )
    def test_the_numbers_are_those_of_python_one_by_one(
        self, bound: PredictableSequence, lower: float, mean: str, squares: str
    ) -> None:
        """Recorded before values were taken together: certificates of that time are verified with these numbers."""
        bound.add_each(np.array([0.6 + 0.001 * (j * 37 % 100) for j in range(1000)]))
        assert (bound.lower(), bound._mean.hex(), bound._squares.hex()) == (lower, mean, squares)

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
            assert (free._bets.wealth > 0).all()
            total += chance * free._bets.wealth.sum(axis=0)
        assert failure <= 0.3
        assert (total[free._bets.candidates >= risk] <= 1 + 1e-12).all()

    @given(st.lists(st.floats(0, 1), max_size=40), st.sampled_from([0.0, 0.2, 1.0]))
    @settings(max_examples=30, deadline=None)
    def test_the_bound_never_falls_and_no_factor_is_negative(self, values: list[float], risk_weight: float) -> None:
        bound = risk_of([], risk_weight)
        last = bound.lower()
        for value in values:
            bound.add(value)
            assert last <= bound.lower() <= 1.0
            assert (bound._bets.wealth > 0).all()
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


MAKES: dict[str, Callable[[], PredictableSequence]] = {
    "CVaR": lambda: CvarSequence(0.1, (0.0, 1.0), delta=0.05),
    "CVaR at the sample quantile": lambda: CvarSequence(0.5, (0.0, 1.0), delta=0.2, choice=sample_quantile),
    "mean": lambda: CvarSequence(1.0, (0.0, 1.0), delta=0.05),
    "risk": lambda: RiskSequence(0.2, (0.0, 1.0), delta=0.05),
    "large risk": lambda: RiskSequence(2.0, (0.0, 1.0), delta=1e-9),
    "never rejected": lambda: RiskSequence(0.0, (0.0, 1.0), delta=1e-299),
}
MANY: dict[str, Callable[[np.random.Generator], np.ndarray[tuple[int], np.dtype[np.float64]]]] = {
    "a density": lambda rng: rng.beta(5, 2, 2_000),
    "two points": lambda rng: rng.choice([0.0, 1.0], 2_000, p=[0.05, 0.95]),
    "a constant": lambda rng: np.full(2_000, 0.3),
    "a drift": lambda rng: np.linspace(0.1, 0.9, 2_000) + rng.uniform(0, 0.1, 2_000),
    "tiny values": lambda rng: rng.choice([0.0, -0.0, 5e-324, 1e-310, 1e-160], 2_000),
}


class TestManyAtOnce:
    """The state is to the bit that of one value after the other."""

    @pytest.mark.parametrize("name", MAKES)
    @given(
        st.lists(st.one_of(st.floats(0, 1), st.sampled_from([0.0, 0.5, 1.0])), min_size=1, max_size=80),
        st.lists(st.integers(1, 40), max_size=8),
    )
    @settings(max_examples=20, deadline=None)
    def test_any_values_in_any_blocks(self, name: str, values: list[float], cuts: list[int]) -> None:
        one, other = MAKES[name](), MAKES[name]()
        for value in values:
            one.add(value)
        for part in blocks(len(values), cuts):
            other.add_each(np.array(values)[part])
        assert state_of(one) == state_of(other)
        assert (one.lower(), one.estimate, one.count) == (other.lower(), other.estimate, len(values))

    @pytest.mark.parametrize("law", MANY)
    @pytest.mark.parametrize("name", MAKES)
    def test_some_thousand_values(self, name: str, law: str) -> None:
        values = MANY[law](np.random.default_rng(6))
        one, other, whole = MAKES[name](), MAKES[name](), MAKES[name]()
        for value in values.tolist():
            one.add(value)
        for part in blocks(len(values), sizes(len(values), 6)):
            other.add_each(values[part])
        whole.add_each(values)
        assert state_of(one) == state_of(other) == state_of(whole)

    @pytest.mark.parametrize("bad", [-0.1, 1.1, math.nan, math.inf])
    def test_an_error_changes_nothing(self, bad: float) -> None:
        for make in MAKES.values():
            bound = make()
            bound.add_each(np.linspace(0.2, 0.4, 30))
            before = state_of(bound)
            with pytest.raises(ValueError, match="must be in"):
                bound.add_each(np.array([0.5, bad, 0.5]))
            assert state_of(bound) == before

    def test_a_value_takes_eight_bytes(self) -> None:
        for make in MAKES.values():
            bound = make()
            bound.add_each(np.random.default_rng(7).uniform(0, 1, 3_000))
            assert bound._sorted.nbytes + bound._fresh.itemsize * len(bound._fresh) == 8 * 3_000
