"""Robustness and gap of formulas whose numbers a person can check."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.stl.parser import FormulaError, parse_formula
from perfbound.orchestrator.mathematics.stl.predicates import predicate_sup
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from tests.facts import facts

NAMES = ("t", "x", "y")


def column(*x: float, step: float = 1.0) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([[k * step, v, 0.0] for k, v in enumerate(x)])


def of(text: str, samples: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return robustness(parse_formula(text, NAMES), NAMES, samples)


class TestIntervals:
    def test_both_ends_belong(self) -> None:
        samples = column(0, 1, 2, 3, 4)
        assert of("always[1,3] x >= 0", samples) == 1
        assert of("eventually[1,3] x >= 0", samples) == 3
        assert of("eventually[1.1,2.9] x >= 0", samples) == 2
        assert of("always[2,inf) x >= 0", samples) == 2
        assert of("always[4,4] x >= 0", samples) == 4

    def test_round_off_of_the_sample_times_does_not_matter(self) -> None:
        samples = column(*range(1801), step=1 / 120)  # 15.0 s up to round-off
        samples[:, 0] = np.cumsum(np.full(1801, 1 / 120)) - 1 / 120
        assert samples[-1, 0] != 15.0
        assert of("eventually[0,15] x >= 0", samples) == 1800
        assert of("always[0.3,0.3] x >= 0", samples) == 36
        assert of("always[0,0.1] eventually[0.2,0.7] x >= 0", samples) == 84

    @pytest.mark.parametrize(("late", "value"), [(1e-8, 2), (0.009, 2), (0.011, 1)])
    def test_more_than_a_hundredth_of_the_step_matters(self, late: float, value: float) -> None:
        samples = column(0, 1, 2)
        samples[2, 0] = 2 + late
        assert of("eventually[0,2] x >= 0", samples) == value

    @pytest.mark.parametrize("gap", [0.0, 1e-12, 5e-10])
    def test_both_values_of_a_jump_count(self, gap: float) -> None:
        samples = column(0, 5, -3, 7)
        samples[:, 0] = 0.0, 1.0, 1.0 + gap, 2.0
        assert of("always[0,1] x >= 0", samples) == -3
        assert of("eventually[0,1] x >= 0", samples) == 5
        assert of("always[1,2] x >= -9", samples) == 6
        assert of("eventually[1,1] x >= 0", samples) == 5
        assert of("(x >= -1) until[0,1] (x >= 4)", samples) == 1

    def test_times_count_from_the_first_sample(self) -> None:
        samples = column(0, 1, 2, 3)
        samples[:, 0] += 100
        assert of("eventually[0,2] x >= 0", samples) == 2

    def test_an_operator_without_end_reads_to_the_end(self) -> None:
        samples = column(3, 2, 1)
        assert of("always x >= 0", samples) == of("always[0,inf) x >= 0", samples) == of("always[0,2] x >= 0", samples)
        assert of("always[0,1] eventually x <= 0", samples) == -1

    @pytest.mark.parametrize("text", ["eventually[0.2,0.8] x >= 0", "x <= 1 until[1.5,1.75] x >= 0"])
    def test_an_interval_without_sample_is_refused(self, text: str) -> None:
        with pytest.raises(FormulaError, match=facts("t = 0 s: least")) as caught:
            of(text, column(0, 1, 2))
        assert caught.value.position is None

    def test_only_samples_that_are_read_count(self) -> None:
        samples = column(0, 1, 2, 3, 4)
        samples[3:, 0] = 10, 20  # from sample 2 on no sample is within 1 s
        assert of("eventually[0.5,1] x >= 0", samples) == 1
        with pytest.raises(FormulaError, match="contains no sample at t = 2 s"):
            of("always[0,2] eventually[0.5,1] x >= 0", samples)

    @pytest.mark.parametrize("times", [(0.0, 2.0, 1.0), (0.0, np.nan, 1.0)])
    def test_times_must_not_decrease(self, times: Sequence[float]) -> None:
        samples = column(0, 1, 2)
        samples[:, 0] = times
        assert of("eventually x >= 0", samples) == 2
        with pytest.raises(ValueError, match=facts("times finite")):
            of("eventually[0,1] x >= 0", samples)


class TestUntil:
    def test_the_two_readings(self) -> None:
        samples = np.array([[0, -5, -1], [1, 2, -1], [2, 3, 1], [3, 1, 4]], dtype=float)
        assert of("x >= 0 until[1,3] y >= 0", samples) == -5  # x is read from now on
        assert of("x >= 0 until_from[1,3] y >= 0", samples) == 1  # x is read from 1 s on
        assert of("x >= 0 until[0,3] y >= 0", samples) == of("x >= 0 until_from[0,3] y >= 0", samples) == -5

    def test_the_left_side_holds_at_the_last_moment_too(self) -> None:
        samples = np.array([[0, 1, -1], [1, -2, 3]], dtype=float)
        assert of("x >= 0 until y >= 0", samples) == -1

    def test_the_paper_writes_always_with_until(self) -> None:
        samples = column(0.1, -0.24, 0.2)
        rho = of("not (0 <= 9 until[0,inf) not abs(x) <= 0.95)", samples)
        assert rho == of("always abs(x) <= 0.95", samples) == pytest.approx(0.71)


class TestRobustness:
    def test_the_segway(self) -> None:
        assert of("always (abs(x) <= 0.95)", column(0.1, -0.24, 0.2)) == pytest.approx(0.71)

    def test_a_constant_formula(self) -> None:
        assert of("always 1 <= 3", np.zeros((2, 3))) == 2.0

    def test_strict_and_not_strict_are_the_same_number(self) -> None:
        assert of("x < 1", column(0.25)) == of("x <= 1", column(0.25)) == of("1 > x", column(0.25)) == 0.75

    def test_unknown_column(self) -> None:
        with pytest.raises(ValueError, match="unknown column 'phi'; known are t, x, y"):
            robustness(parse_formula("phi <= 1"), NAMES, np.zeros((2, 3)))

    @pytest.mark.parametrize("text", ["1 / x <= 1", "(0 - 1 - x)^0.5 <= 1", "eventually (x / x <= 1 or y <= 5)"])
    def test_a_predicate_that_is_not_finite_is_refused(self, text: str) -> None:
        with pytest.raises(ValueError, match="at sample 0, not a finite number"):
            of(text, np.zeros((2, 3)))

    def test_a_nan_sample_is_refused(self) -> None:
        with pytest.raises(ValueError, match="`x <= 1` is nan at sample 1"):
            of("eventually x <= 1", column(0.0, np.nan, 0.0))

    @pytest.mark.parametrize("shape", [(0, 3), (2, 2), (3,)])
    def test_shapes(self, shape: tuple[int, ...]) -> None:
        with pytest.raises(ValueError, match="do not fit"):
            robustness(parse_formula("x <= 1"), NAMES, np.zeros(shape))


class TestPredicateSup:
    def test_is_the_largest_over_predicates_and_samples(self) -> None:
        a, b = column(0.0, 1.0), column(0.5, 3.0)
        assert predicate_sup(parse_formula("x <= 1"), NAMES, a, b) == 2.0
        assert predicate_sup(parse_formula("eventually (x <= 1 and x^2 >= 4)"), NAMES, a, b) == 8.0
        assert predicate_sup(parse_formula("x <= 1 until[0,9] x / 8 <= 1"), NAMES, a, b) == 2.0  # needs no horizon
        assert predicate_sup(parse_formula("1 <= 2"), NAMES, a, b) == 0.0

    def test_is_the_paper_s_gap_for_its_specification(self) -> None:
        a, b = column(0.3, -0.2), column(0.1, -0.6)
        gap = predicate_sup(parse_formula("always abs(x) <= 0.95"), NAMES, a, b)
        assert gap == pytest.approx(0.4) == np.max(np.abs(a[:, 1] - b[:, 1]))

    def test_one_grid(self) -> None:
        tree, a = parse_formula("x <= 1"), column(0.0, 1.0)
        with pytest.raises(ValueError, match=facts("2 3 samples gap time")):
            predicate_sup(tree, NAMES, a, column(0.0, 1.0, 2.0))
        with pytest.raises(ValueError, match="differ at sample 1: t = 1 and 2"):
            predicate_sup(tree, NAMES, a, column(0.0, 1.0, step=2.0))

    def test_what_is_not_finite_is_refused(self) -> None:
        with pytest.raises(ValueError, match="nan at sample 1"):
            predicate_sup(parse_formula("x <= 1"), NAMES, column(0.0, 1.0), column(0.0, np.nan))
        with pytest.raises(ValueError, match="the gap is inf"):
            predicate_sup(parse_formula("x <= 1"), NAMES, column(1e308), column(-1e308))
