"""Theorem 2, probabilities of several bounds, and outward rounding."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.composition import (
    Composition,
    Rule,
    VarianceBound,
    compose,
    compose_mean,
    derived_noise_scale,
    joint_probability,
    least_risk,
    pointwise_mean,
)
from perfbound.orchestrator.mathematics.bounds.one_law.risk import bhatia_davis
from perfbound.orchestrator.mathematics.bounds.paper.formulas import mills_probability
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.bounds.rounding import round_down, round_up
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from tests.fakes.observations import an_observation

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
    @example(rho=-215938.55190666893, gap=999999.0, lipschitz=8.172677893254665, r=0.0)
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


CLIP = (-0.05, 0.75)
VARIANCES: tuple[VarianceBound, ...] = ("bhatia-davis", "popoviciu")


class TestBhatiaDavis:
    def test_vector(self) -> None:
        assert bhatia_davis(0.558, CLIP, 0.2) == pytest.approx(0.489667, abs=5e-7)
        ell = {v: least_risk(0.558, risk_weight=0.2, clip=CLIP, variance=v) for v in VARIANCES}
        assert ell["popoviciu"] == 0.478
        assert ell["bhatia-davis"] == pytest.approx(0.489667, abs=5e-7)
        assert ell["bhatia-davis"] <= bhatia_davis(0.558, CLIP, 0.2)

    @given(st.floats(-0.2, 0.9), st.floats(0, 5))
    def test_is_the_least_value_right_of_the_bound(self, b: float, r: float) -> None:
        means = np.linspace(min(max(b, -0.05), 0.75), 0.75, 2001)
        values = means - r * np.sqrt(np.maximum((0.75 - means) * (means + 0.05), 0.0))
        ell = bhatia_davis(b, CLIP, r)
        assert ell <= values.min() + 1e-12
        assert ell >= values.min() - 1e-3 * (1 + r)

    @given(st.floats(-0.05, 0.75), st.floats(-0.05, 0.75), st.floats(0, 5))
    def test_monotone_and_never_below_popoviciu(self, one: float, other: float, r: float) -> None:
        low, high = sorted((one, other))
        assert bhatia_davis(low, CLIP, r) <= bhatia_davis(high, CLIP, r) + 1e-12
        assert bhatia_davis(low, CLIP, r) >= low - r * 0.4 - 1e-12

    @given(st.lists(st.floats(-0.05, 0.75), min_size=2, max_size=9), st.floats(0, 2))
    def test_holds_for_every_sample(self, values: list[float], r: float) -> None:
        risk = float(np.mean(values)) - r * float(np.std(values))
        assert bhatia_davis(float(np.mean(values)), CLIP, r) <= risk + 1e-9

    def test_refuses(self) -> None:
        for wrong in ((math.nan, CLIP, 0.2), (0.5, CLIP, -1.0), (0.5, (0.75, -0.05), 0.2)):
            with pytest.raises(ValueError, match=r"finite|risk_weight|clip"):
                bhatia_davis(*wrong)
        with pytest.raises(ValueError, match="popoviciu"):
            least_risk(0.5, risk_weight=0.2, clip=CLIP, variance="chebyshev")  # type: ignore[arg-type]


class TestGaps:
    def test_means(self) -> None:
        assert compose_mean(0.688, 0.13, kind="robustness", clip=CLIP) == 0.558
        assert compose_mean(0.688, 0.13, kind="predicate_sup", clip=CLIP) == 0.558
        assert compose_mean(0.688, 0.065, kind="signal_sup", clip=CLIP, lipschitz=2.0) == 0.558
        assert compose_mean(0.1, 0.5, kind="predicate_sup", clip=CLIP) == -0.05

    @pytest.mark.parametrize(("kind", "lipschitz"), [("signal_sup", -1.0), ("robustness", 2.0)])
    def test_refuses_lipschitz(self, kind: str, lipschitz: float) -> None:
        with pytest.raises(ValueError, match="lipschitz"):
            compose_mean(0.5, 0.1, kind=kind, clip=CLIP, lipschitz=lipschitz)  # type: ignore[arg-type]

    def test_derived_noise_scale(self) -> None:
        def scale(kind: str, nominal: bool, common: bool, lipschitz: float = 1.0) -> float:
            return derived_noise_scale(
                kind,  # type: ignore[arg-type]
                CLIP,
                deterministic_nominal=nominal,
                common_seeds=common,
                lipschitz=lipschitz,
            )

        assert scale("nominal_robustness", True, False) == 0.0
        assert scale("nominal_robustness", False, False) == 0.4
        assert scale("signal_sup", True, False, 2.0) == 0.2
        assert scale("predicate_sup", False, True) == 0.4
        assert scale("robustness", True, True) == 0.4
        assert scale("robustness", False, False) == pytest.approx(0.8 / math.sqrt(2))
        assert scale("robustness", False, True) == 0.8
        for kind, lipschitz in (("true_risk", 1.0), ("signal_sup", 0.0)):
            with pytest.raises(ValueError, match=r"derived|lipschitz"):
                scale(kind, True, False, lipschitz)


class TestPointwise:
    LATTICE = Lattice((0.0, 0.0), (5.0, 5.0), 6)

    def method(self, candidates: Lattice | Points, kernel: Matern, values: Floats, mean: float) -> RigorousMethod:
        method = RigorousMethod(candidates, kernel, Premises(0.3, 0.0, 0.05, ()), alpha=0.01, prior_mean=mean)
        for z in range(0, 36, 3):
            method.observe(*an_observation(z, float(values[z])))
        return method

    @pytest.mark.parametrize("finite", [True, False])
    def test_between_the_extremes_and_the_truth(self, finite: bool) -> None:
        nodes = self.LATTICE.nodes
        candidates = Points(tuple(map(tuple, nodes.tolist()))) if finite else self.LATTICE
        rough, smooth = Matern(0.5, 4.0), Matern(2.5, 3.0)
        rho = 0.7 - 0.1 * np.exp(-np.linalg.norm(nodes - [5, 5], axis=1) / 4)
        gap = 0.03 + 0.1 * Matern(2.5, 3.0)(np.linalg.norm(nodes, axis=1))
        one = self.method(candidates, rough, -rho, -0.7)
        two = self.method(candidates, smooth, gap, 0.03)
        extremes = compose_mean(-one.bound().upper, two.bound().upper, kind="robustness", clip=CLIP)
        mean = pointwise_mean(one.envelope, two.envelope, candidates, clip=CLIP, slack=0.005, extremes=-0.05)
        brute = float((-one.envelope.at(nodes)[0] - two.envelope.at(nodes)[0]).min())
        assert mean <= brute
        assert mean >= brute - (1e-8 if finite else 0.06)
        assert extremes < mean <= (rho - gap).min()
        assert pointwise_mean(one.envelope, two.envelope, candidates, clip=CLIP, slack=0.005, extremes=0.6) == 0.6
        scaled = two.envelope.scaled(2.0)
        np.testing.assert_allclose(scaled.at(nodes)[0], 2 * two.envelope.at(nodes)[0], atol=1e-12)

    def test_refuses(self) -> None:
        envelope = self.method(self.LATTICE, Matern(0.5, 4.0), np.zeros(36), 0.0).envelope
        with pytest.raises(ValueError, match="slack"):
            pointwise_mean(envelope, envelope, self.LATTICE, clip=CLIP, slack=0.0, extremes=0.0)
