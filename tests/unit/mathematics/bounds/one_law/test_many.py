"""Sums, squares and ranges of arrays against Python's numbers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law import many
from perfbound.orchestrator.mathematics.bounds.one_law.many import (
    are_within,
    exact_sum,
    linearised_each,
    squares,
    units,
)
from perfbound.orchestrator.mathematics.bounds.one_law.risk import RiskReading, linearised

FLOATS = st.floats(-1e300, 1e300)


@pytest.fixture
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "FEW", 0)


@pytest.mark.usefixtures("_few")
class TestExactSum:
    @given(st.lists(FLOATS, max_size=60))
    @settings(max_examples=200, deadline=None)
    def test_it_is_fsum(self, values: list[float]) -> None:
        assert exact_sum(np.array(values)) == math.fsum(values)

    @given(st.lists(FLOATS, min_size=1, max_size=30), st.integers(0, 5))
    @settings(max_examples=100, deadline=None)
    def test_it_is_fsum_where_terms_cancel(self, values: list[float], seed: int) -> None:
        both = np.random.default_rng(seed).permutation([*values, *(-value for value in values), 1e-200])
        assert exact_sum(both) == math.fsum(both.tolist())

    @pytest.mark.parametrize("count", [1, many.PIECE - 1, many.PIECE, 3 * many.PIECE + 7])
    @pytest.mark.parametrize("exponents", [(0, 1), (-320, 290)])
    def test_of_any_number_and_any_size(self, count: int, exponents: tuple[int, int]) -> None:
        rng = np.random.default_rng(count)
        values = rng.normal(size=count) * 10.0 ** rng.uniform(*exponents, count)
        assert exact_sum(values) == math.fsum(values.tolist())

    def test_the_largest_multiples_of_a_piece_add_up_exactly(self) -> None:
        for value in (math.nextafter(1.0, 0.0), 1.0, math.nextafter(2.0, 0.0), 0.1, 2.0**-1074, 1e300):
            assert exact_sum(np.full(many.PIECE, value)) == math.fsum([value] * many.PIECE)


class TestSquares:
    @pytest.mark.parametrize("count", [0, 1, 50_000])
    def test_they_are_those_of_python(self, count: int) -> None:
        values = np.random.default_rng(1).normal(size=count)
        assert squares(values).tolist() == [value**2 for value in values.tolist()]


class TestRange:
    @given(st.lists(st.floats(), min_size=1, max_size=6))
    def test_a_value_outside_is_found(self, values: list[float]) -> None:
        assert are_within(np.array(values), -1.0, 1.0) == all(-1.0 <= value <= 1.0 for value in values)

    def test_of_tests_with_several_values(self) -> None:
        assert are_within(np.zeros((3, 2)), 0.0, 0.0)
        assert not are_within(np.array([[0.0, 0.0], [0.0, math.nan]]), -math.inf, math.inf)


class TestReadings:
    @pytest.mark.parametrize("risk_weight", [0.0, 0.2, 2.0])
    def test_the_linearised_risk_is_that_of_one_value(self, risk_weight: float) -> None:
        values = np.random.default_rng(2).uniform(-0.05, 0.75, 5_000)
        found = linearised_each(values, squares(values - 0.7), risk_weight, 0.09)
        assert found.tolist() == [linearised(value, risk_weight, 0.7, 0.09) for value in values.tolist()]

    @pytest.mark.parametrize("constants", [None, (0.7, 0.09)])
    def test_a_unit_is_the_place_between_the_ends(self, constants: tuple[float, float] | None) -> None:
        reading = RiskReading((-0.05, 0.75), 0.2, constants)
        values = np.random.default_rng(3).uniform(-0.05, 0.75, 200)
        values[:4] = (-0.05, 0.75, 0.0, 0.7)
        low, high = reading.ends
        moved = [value if constants is None else linearised(value, 0.2, *constants) for value in values.tolist()]
        assert units(values, reading).tolist() == [min(max((each - low) / (high - low), 0.0), 1.0) for each in moved]
