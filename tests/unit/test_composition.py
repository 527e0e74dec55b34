"""Theorem 2, probabilities of several bounds, and outward rounding."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.bounds.composition import Composition, Rule, compose, joint_probability, round_down, round_up
from orchestrator.bounds.paper import mills_probability

finite = st.floats(-1e6, 1e6, allow_nan=False)
RULES: tuple[Rule, ...] = ("sum", "product")
multiples = st.integers(-(10**15), 10**15)


def paper(**changed: object) -> Composition:
    arguments: dict[str, object] = {
        "robustness": 0.46,
        "gap": 0.38,
        "lipschitz": 1.0,
        "risk_weight": 0.2,
        "clip": (-0.05, 0.75),
        "probabilities": (0.9, 0.8),
        "rule": "product",
    }
    return compose(**{**arguments, **changed})  # type: ignore[arg-type]


class TestCompose:
    def test_the_segway_of_the_paper(self) -> None:
        delta = mills_probability(0.2, 0.05, 0.1, "gaussian")
        result = paper(probabilities=(delta, delta))
        assert (result.robustness, result.gap, result.spread, result.ell) == (0.46, 0.38, 0.08, 0.0)
        assert result.probability == pytest.approx(0.854431, abs=5e-7)
        assert result.probability <= delta * delta

    def test_sub_gaussian_square(self) -> None:
        delta = mills_probability(0.2, 0.05, 0.1, "sub-gaussian")
        assert paper(probabilities=(delta, delta)).probability == pytest.approx(0.674750, abs=1e-6)

    def test_popoviciu_vector(self) -> None:
        assert paper(robustness=0.558, gap=0.0).ell == 0.478

    def test_lipschitz_scales_the_gap(self) -> None:
        assert paper(lipschitz=2.0).ell == -0.38

    @given(finite, finite, st.floats(0, 10), st.floats(0, 2))
    def test_never_above_the_exact_value(self, rho: float, gap: float, lipschitz: float, r: float) -> None:
        result = paper(robustness=rho, gap=gap, lipschitz=lipschitz, risk_weight=r)
        exact = (
            Fraction(repr(rho)) - Fraction(repr(lipschitz)) * Fraction(repr(gap)) - Fraction(repr(r)) * Fraction(2, 5)
        )
        assert Fraction(repr(result.ell)) <= exact < Fraction(repr(result.ell)) + Fraction(1, 10**8)

    @pytest.mark.parametrize(
        ("changed", "message"),
        [
            ({"robustness": math.nan}, "finite"),
            ({"gap": math.inf}, "finite"),
            ({"lipschitz": -1.0}, "lipschitz"),
            ({"risk_weight": -0.1}, "risk_weight"),
            ({"clip": (0.75, -0.05)}, "clip"),
            ({"probabilities": ()}, "at least one"),
            ({"probabilities": (1.5,)}, r"\[0, 1\]"),
            ({"rule": "maximum"}, "rule"),
        ],
    )
    def test_refuses(self, changed: dict[str, object], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            paper(**changed)


class TestJointProbability:
    @given(st.lists(st.floats(0, 1), min_size=1, max_size=5))
    def test_the_sum_is_never_above_the_product(self, probabilities: list[float]) -> None:
        total, product = (joint_probability(probabilities, rule) for rule in RULES)
        assert 0 <= total <= product + 1e-15 <= min(probabilities) + 2e-15

    def test_sum(self) -> None:
        assert joint_probability((0.95, 0.95), "sum") == pytest.approx(0.9)
        assert joint_probability((0.3, 0.3), "sum") == 0.0


class TestRounding:
    @given(multiples)
    def test_a_multiple_does_not_move(self, k: int) -> None:
        assert round_down(k / 10**9) == round_up(k / 10**9) == k / 10**9

    @given(finite)
    def test_outward_by_less_than_a_step(self, x: float) -> None:
        assert round_down(x) <= x <= round_up(x)
        assert round_up(x) - round_down(x) <= 1.001e-9 + 4 * math.ulp(x)

    @given(finite)
    def test_idempotent_and_mirrored(self, x: float) -> None:
        assert round_down(round_down(x)) == round_down(x)
        assert round_up(-x) == -round_down(x)

    def test_values(self) -> None:
        assert (round_down(0.1 + 0.2), round_up(0.1 + 0.2)) == (0.3, 0.300000001)
        assert (round_down(-1e-12), round_up(-1e-12)) == (-1e-9, 0.0)

    @pytest.mark.parametrize("x", [math.nan, math.inf, -math.inf])
    def test_refuses(self, x: float) -> None:
        with pytest.raises(ValueError, match="finite"):
            round_down(x)
        with pytest.raises(ValueError, match="finite"):
            round_up(x)
