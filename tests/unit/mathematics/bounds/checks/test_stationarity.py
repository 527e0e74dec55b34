"""One law per start: exact ranks, the exact mean wealth, ties, adaptive returns, drifts, bad input."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.checks.stationarity import (
    AT_ONCE,
    RECENT,
    AdaptiveOrderTest,
    PlannedOrderTest,
    _Column,
    _Ranks,
)
from perfbound.orchestrator.mathematics.bounds.rounding import ROUND_OFF


def column_of(values: list[float], starts: int | None = 1) -> AdaptiveOrderTest:
    test = AdaptiveOrderTest(starts=starts)
    for n, value in enumerate(values):
        test.observe("a", n, value)
    return test


class TestRanks:
    @given(st.lists(st.floats(-10, 10), min_size=1, max_size=30, unique=True))
    def test_the_place_is_the_middle_of_its_rank(self, values: list[float]) -> None:
        ranks, ties = _Ranks(), np.random.default_rng(0)
        for n, value in enumerate(values, 1):
            below = sum(other < value for other in values[: n - 1])
            assert ranks.place(value, ties) == (below + 0.5) / n

    def test_ties_are_ranked_at_random_and_uniformly(self) -> None:
        ties = np.random.default_rng(1)
        places = []
        for _ in range(3000):
            ranks = _Ranks()
            places.append([ranks.place(0.7, ties) for _ in range(3)][2])
        assert np.bincount(np.round(np.array(places) * 3 - 0.5).astype(int)) == pytest.approx([1000] * 3, rel=0.1)

    def test_the_mean_wealth_over_all_orders_is_one(self) -> None:
        total = 0.0
        for order in itertools.permutations(range(6)):
            column, ties = _Column(), np.random.default_rng(0)
            for value in order:
                column.add(column.ranks.place(float(value), ties))
            total += math.fsum(column._wealth._each)
        assert total / math.factorial(6) == pytest.approx(1, abs=1e-12)


class TestAdaptive:
    @given(st.lists(st.floats(-5, 5), max_size=60), st.floats(0.1, 10), st.floats(-5, 5))
    @settings(max_examples=30, deadline=None)
    def test_only_the_order_of_values_matters(self, values: list[float], scale: float, shift: float) -> None:
        rounded = [round(value, 2) for value in values]  # so that scaling keeps ties and order
        assert column_of(rounded).finding() == column_of([scale * value + shift for value in rounded]).finding()

    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    def test_a_drift_in_either_direction_is_refuted(self, sign: float) -> None:
        rng = np.random.default_rng(2)
        values = rng.standard_normal(800) + sign * np.linspace(0, 1, 800)
        finding = column_of(list(map(float, values))).finding()
        assert finding.status == "refuted"
        assert finding.values["threshold"] == 100

    def test_evidence_that_rounding_may_have_lifted_to_the_limit_refutes_nothing(self) -> None:
        values = np.linspace(0, 1, 40).tolist()

        def at(level: float) -> AdaptiveOrderTest:
            test = AdaptiveOrderTest(starts=1, level=level)
            for n, value in enumerate(values):
                test.observe("a", n, value)
            return test

        reached = at(0.01)._columns["a"].peak
        assert at(1 / reached).finding().status == "not refuted"
        assert at((1 + 2 * ROUND_OFF) / reached).finding().status == "refuted"

    def test_equal_values_refute_nothing(self) -> None:
        assert column_of([0.75] * 500).finding().status == "not refuted"

    def test_without_a_second_value_it_is_assumed(self) -> None:
        test = AdaptiveOrderTest()
        assert test.finding().status == "assumed"
        for n in range(5):
            test.observe(n, n, 0.5)
        assert test.finding().status == "assumed"

    def test_without_a_list_the_first_test_of_a_start_is_discarded(self) -> None:
        test = AdaptiveOrderTest()
        for n, value in enumerate([0.1, 0.2, 0.3, 0.4]):
            test.observe("a", n // 2, value)
        assert test.finding().values["values"] == 2

    def test_shares_of_the_level_sum_to_one(self) -> None:
        assert math.fsum(AdaptiveOrderTest()._share(k) for k in range(1, 10_000)) == pytest.approx(1, abs=1e-3)
        assert [AdaptiveOrderTest(starts=2)._share(k) for k in (1, 2, 3)] == [0.5, 0.5, 0.0]

    def test_the_start_that_drifts_is_named(self) -> None:
        test = AdaptiveOrderTest(starts=3)
        rng = np.random.default_rng(3)
        for n in range(300):
            for start in range(3):
                test.observe(start, n, float(rng.standard_normal() + (start == 1) * n / 100))
        assert (test.finding().status, test.finding().values["start"]) == ("refuted", 1)


def state_of(test: AdaptiveOrderTest) -> object:
    columns = {
        start: (
            np.sort(np.concatenate([column.ranks._old, column.ranks._recent])).tolist(),
            column._wealth._each.tolist(),
            column.peak,
        )
        for start, column in test._columns.items()
    }
    return columns, test._first_test, test._ties.bit_generator.state, test.finding()


def check_pieces(values: np.ndarray, tests: np.ndarray, starts: int | None, pieces: list[int]) -> None:
    """Check that values one by one, in pieces and at once leave the same state, to the bit."""
    one, many, whole = (AdaptiveOrderTest(starts=starts) for _ in range(3))
    for number, value in zip(tests.tolist(), values.tolist(), strict=True):
        one.observe("a", number, value)
    first = 0
    for piece in itertools.cycle([*pieces, 1]):
        many.observe_each("a", tests[first : first + piece], values[first : first + piece])
        first += piece
        if first >= len(values):
            break
    whole.observe_each("a", tests, values)
    assert state_of(one) == state_of(many) == state_of(whole)


class TestManyAtOnce:
    @given(
        st.lists(st.one_of(st.floats(-5, 5), st.integers(-2, 2).map(float)), max_size=300),
        st.lists(st.integers(0, 150), max_size=4),
        st.sampled_from([1, None]),
        st.integers(1, 9),
    )
    @settings(max_examples=60, deadline=None)
    def test_pieces_are_what_one_by_one_is(
        self, values: list[float], pieces: list[int], starts: int | None, replicates: int
    ) -> None:
        check_pieces(np.array(values), np.arange(len(values)) // replicates, starts, pieces)

    @pytest.mark.parametrize("low", [-0.5, -5.0])
    def test_it_is_the_same_beyond_every_size_with_ties_at_the_ends_of_a_clip(self, low: float) -> None:
        count = RECENT + 3 * AT_ONCE
        values = np.clip(np.random.default_rng(5).standard_normal(count), low, 0.8)
        check_pieces(values, np.arange(count), 1, [7, 1500, 0, 130, 3000])

    def test_it_is_the_same_where_wealth_is_discarded(self) -> None:
        values = np.append(np.arange(4000.0), np.random.default_rng(6).uniform(0, 4000, 500))
        check_pieces(values, np.arange(4500), 1, [900, 1, 64])

    def test_starts_share_the_ties(self) -> None:
        one, many = AdaptiveOrderTest(starts=2), AdaptiveOrderTest(starts=2)
        values = np.random.default_rng(7).integers(0, 5, 400).astype(float)
        for first in range(0, 400, 50):
            for number in range(first, first + 50):
                one.observe(first % 100, number, values[number])
            many.observe_each(first % 100, np.arange(first, first + 50), values[first : first + 50])
        assert state_of(one) == state_of(many)

    def test_nothing_changes_where_a_value_is_refused(self) -> None:
        test = AdaptiveOrderTest()
        test.observe_each("a", np.arange(3), np.array([1.0, 2.0, 2.0]))
        before = state_of(test)
        with pytest.raises(ValueError, match="finite, not nan"):
            test.observe_each("b", np.arange(3), np.array([1.0, math.nan, math.inf]))
        assert state_of(test) == before


class TestPlanned:
    def test_an_opening_and_a_closing_round_catch_a_drift_by_half_a_deviation(self) -> None:
        rng = np.random.default_rng(4)
        plan = [(n % 100, float(n >= 400)) for n in range(800)]
        test, means = PlannedOrderTest(plan), rng.normal(0, 3, 100)
        for start, time in plan:
            test.observe(float(means[start] + 0.5 * time + rng.standard_normal()))
        assert test.finding().status == "refuted"

    def test_different_starts_are_not_compared(self) -> None:
        test = PlannedOrderTest([(n, float(n)) for n in range(100)])
        for n in range(100):
            test.observe(float(n))
        assert test.finding().status == "assumed"

    def test_the_mean_wealth_over_all_orders_is_one(self) -> None:
        plan = [("a", 0.0), ("a", 0.0), ("a", 1.0), ("a", 2.0), ("a", 2.0)]
        total = 0.0
        for order in itertools.permutations(range(5)):
            test = PlannedOrderTest(plan)
            for value in order:
                test.observe(float(value))
            total += math.fsum(test._evidence._each)
        assert total / math.factorial(5) == pytest.approx(1, abs=1e-12)

    def test_the_plan_ends(self) -> None:
        test = PlannedOrderTest([("a", 0.0)])
        test.observe(1.0)
        with pytest.raises(ValueError, match="plan"):
            test.observe(1.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: AdaptiveOrderTest(level=0.0),
        lambda: AdaptiveOrderTest(starts=0),
        lambda: AdaptiveOrderTest().observe(0, 0, math.nan),
        lambda: PlannedOrderTest([]),
        lambda: PlannedOrderTest([("a", 1.0), ("a", 0.0)]),
        lambda: PlannedOrderTest([("a", math.inf)]),
        lambda: PlannedOrderTest([("a", 0.0)]).observe(math.inf),
    ],
)
def test_bad_input_is_refused(call: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=r"must|needs"):
        call()


def test_what_has_no_two_values_at_a_start_has_no_evidence() -> None:
    found = AdaptiveOrderTest().finding()
    assert (found.status, found.values["e_value"]) == ("assumed", 0.0)
