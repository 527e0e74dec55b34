"""The audit: each assumption's status, and a sentence with the numbers that decided it."""

import math
import random

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds import audit
from perfbound.orchestrator.mathematics.bounds.confidence import mixture
from perfbound.orchestrator.mathematics.bounds.rigorous import RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from tests.fakes.observations import an_observation


def norm(y: list[float], **changed: float) -> audit.Assumption:
    arguments = {"prior_mean": 0.0, "rkhs_norm": 0.1, "noise_scale": 0.05, "delta": 0.05, **changed}
    return audit.rkhs_norm("sim_gap", y, **arguments)


class TestNorm:
    def test_the_papers_segway_is_refuted(self) -> None:
        result = audit.rkhs_norm("nominal", [-0.71] * 60, prior_mean=0, rkhs_norm=0.2, noise_scale=0.1, delta=0.05)
        assert (result.id, result.status) == ("rkhs_norm/nominal", "refuted")
        assert result.detail == (
            "largest |y - m0| = 0.71 with B = 0.2 (60 of 60 tests above B) exceeds 0.594543, the most that B and the "
            "noise allow at confidence 0.95: B, the noise scale or the prior mean is wrong and the bound is not proven."
        )

    def test_threshold(self) -> None:
        threshold = 0.1 + 0.05 * math.sqrt(2 * math.log(2 * 3 / 0.05))
        assert norm([0.0, 0.0, threshold - 1e-9]).status == "not refuted"
        assert norm([0.0, 0.0, -threshold - 1e-9]).status == "refuted"

    def test_not_refuted_promises_nothing(self) -> None:
        result = norm([0.05, 0.12])
        assert result.status == "not refuted"
        assert "(1 of 2 tests above B)" in result.detail
        assert "does not show" in result.detail

    def test_prior_mean_is_subtracted(self) -> None:
        assert norm([0.7], prior_mean=0.73).status == "not refuted"

    def test_no_noise(self) -> None:
        assert norm([0.1], noise_scale=0.0).status == "not refuted"
        assert norm([0.1 + 1e-9], noise_scale=0.0).status == "refuted"

    def test_false_refutations_stay_below_delta(self) -> None:
        rng = random.Random(0)
        refuted = sum(norm([rng.gauss(0.1, 0.05) for _ in range(20)]).status == "refuted" for _ in range(1000))
        assert refuted <= 50

    @pytest.mark.parametrize("y", [[], [math.nan], [0.0, math.inf]])
    def test_refuses(self, y: list[float]) -> None:
        with pytest.raises(ValueError, match="sim_gap needs finite"):
            norm(y)


class TestRigorous:
    def test_norm_from_data(self) -> None:
        def result(b_min: float, noise: float = 0.05) -> audit.Assumption:
            return audit.norm_from_data("gap", b_min=b_min, rkhs_norm=0.2, delta=0.05, noise_scale=noise)

        assert (result(0.21).id, result(0.21).status) == ("rkhs_norm/gap", "refuted")
        assert "at least 0.21 at confidence 0.95" in result(0.21).detail
        assert "with certainty" in result(0.21, noise=0.0).detail
        assert result(0.2).status == "not refuted"
        assert "margin of 0.05" in result(0.15).detail
        assert "not evidence" in result(0.15).detail
        with pytest.raises(ValueError, match="b_min"):
            result(math.nan)

    def test_the_papers_test_function_is_refuted(self) -> None:
        lattice, rng = Lattice((0, 0), (5, 5), 51), np.random.default_rng(0)
        points = Points(tuple(map(tuple, lattice.nodes[rng.choice(2601, 25, replace=False)].tolist())))
        method = RigorousMethod(
            points,
            Matern(10, 1.0),
            rkhs_norm=0.25,
            noise_scale=0.005,
            delta=0.05,
            alpha=0.015,
            regularisers=mixture(0.25, 0.005),
        )
        for z, (x, y) in enumerate(points.nodes):
            method.observe(*an_observation(z, math.sin(x) * math.cos(y) / 2 + rng.normal(0, 0.001)))
        assert method.bound().status == "refuted"
        assert 0.6 <= method.bound().b_min <= 1.0

    def test_bounds_agree(self) -> None:
        assert audit.bounds_agree("a", upper=0.5, lower=0.4).status == "not refuted"
        assert audit.bounds_agree("a", upper=0.4, lower=0.4 + 5e-10).status == "not refuted"
        assert audit.bounds_agree("a", upper=0.4, lower=0.41).status == "refuted"

    def test_replicate_spread_is_a_hint_near_r_and_a_refutation_far_above(self) -> None:
        def spread(*groups: tuple[float, ...]) -> audit.Assumption:
            return audit.replicate_spread("a", groups, noise_scale=0.1, delta=0.05, planned=10)

        wide = spread((0.0, 0.3), (0.1, 0.1))
        assert (wide.id, wide.status) == ("replicate_spread/a", "assumed")
        assert "0.15 per rollout" in wide.detail
        assert "hint" in wide.detail
        assert (
            audit.replicate_spread("a", [(0.0, 0.1)], noise_scale=0.1, delta=0.05, planned=10).status == "not refuted"
        )
        assert (
            "no test has two" in audit.replicate_spread("a", [(0.0,)], noise_scale=0.1, delta=0.05, planned=10).detail
        )
        with pytest.raises(ValueError, match="finite"):
            audit.replicate_spread("a", [(0.0, math.nan)], noise_scale=0.1, delta=0.05, planned=10)

    def test_replicate_spread_rarely_refutes_the_right_r(self) -> None:
        """Gaussian noise of sd R is R-sub-Gaussian: alarms at any of five looks in at most delta of 400 campaigns."""
        rng, alarms = np.random.default_rng(0), 0

        def status(groups: list[list[float]]) -> str:
            return audit.replicate_spread("a", groups, noise_scale=0.1, delta=0.05, planned=100).status

        for _ in range(400):
            noise = rng.normal(0.0, 0.1, (25, 4)).tolist()
            alarms += any(status(noise[:n]) == "refuted" for n in (5, 10, 15, 20, 25))
        assert alarms <= 34  # 99.9 % quantile of binomial(400, .05)
        assert status(rng.normal(0.0, 0.14, (25, 4)).tolist()) == "refuted"

    def test_deterministic_variant(self) -> None:
        assert audit.deterministic_variant("a", [(0.5, 0.5), (0.1,)]).status == "not refuted"
        assert audit.deterministic_variant("a", [(0.5, math.nextafter(0.5, 1))]).status == "refuted"
        assert audit.deterministic_variant("a", [(math.nan, math.nan)]).status == "refuted"
        assert audit.deterministic_variant("a", [(0.5,)]).status == "assumed"

    def test_noise_range(self) -> None:
        assert audit.noise_range("a", noise_scale=0.4, hoeffding=0.4).status == "derived"
        assert audit.noise_range("a", noise_scale=0.39, hoeffding=0.4).status == "assumed"

    def test_kernel(self) -> None:
        plain = audit.misspecification("a", tau=0.0, nu=0.5, length_scale=4, rkhs_norm=0.15)
        assert (plain.id, plain.status) == ("kernel/a", "assumed")
        assert "further than 0.01" in audit.misspecification("a", tau=0.01, nu=0.5, length_scale=4, rkhs_norm=1).detail


class TestOthers:
    def test_clipped_share(self) -> None:
        result = audit.clipped_share("nominal", [-0.05, 0.3, 0.75, 0.75], (-0.05, 0.75))
        assert (result.id, result.status) == ("clip/nominal", "derived")
        assert "of 4 robustness values 1 (25.0 %) sit at the lower clip -0.05 and 2 (50.0 %)" in result.detail
        with pytest.raises(ValueError, match="at least one"):
            audit.clipped_share("nominal", [], (0.0, 1.0))

    def test_tail_reports_both(self) -> None:
        gaussian = audit.noise_tail("a", c=0.2, delta=0.05, noise_scale=0.1, tail="gaussian")
        other = audit.noise_tail("a", c=0.2, delta=0.05, noise_scale=0.1, tail="sub-gaussian")
        assert (gaussian.status, other.status) == ("assumed", "derived")
        for result in (gaussian, other):
            assert result.id == "tail/a"
            assert "0.924354" in result.detail
            assert "0.821431" in result.detail

    def test_sigma(self) -> None:
        assert "too narrow" in audit.sigma_reading("a", "variance").detail
        assert "standard deviation" in audit.sigma_reading("a", "std").detail

    def test_regulariser(self) -> None:
        assert "2/i" in audit.regulariser("a", "1+eta").detail
        assert "0.01" in audit.regulariser("a", 0.01).detail

    def test_noise_scale(self) -> None:
        assert audit.noise_scale("a", noise_scale=0.05, replicates=4).id == "noise_scale/a"

    def test_lattice(self) -> None:
        result = audit.lattice_for_box("a", Lattice((0, 0), (5, 5), 51), Matern(10, 1.0), 0.25)
        assert result.status == "assumed"
        assert "2601 nodes" in result.detail
        rise = 0.25 * math.sqrt(2 - 2 * float(Matern(10, 1.0)(np.array([math.hypot(0.05, 0.05)]))[0]))
        assert f"up to {rise:.6g}" in result.detail

    def test_independence(self) -> None:
        assert "multiplied" in audit.independent_problems(["a", "b"], "product").detail
        assert "added" in audit.independent_problems(["a", "b"], "sum").detail

    def test_workers(self) -> None:
        assert (audit.workers_honest().id, audit.workers_honest().status) == ("workers_honest", "assumed")

    def test_true_risk_is_refuted_by_derivation(self) -> None:
        result = audit.centred_risk("true_risk", 10)
        assert (result.id, result.status) == ("centred_noise/true_risk", "refuted")
        assert "2.7 %" in result.detail
        with pytest.raises(ValueError, match="at least 2"):
            audit.centred_risk("true_risk", 1)

    def test_every_detail_is_one_sentence(self) -> None:
        results = [
            norm([0.1]),
            norm([9.0]),
            audit.clipped_share("a", [0.1], (0.0, 1.0)),
            audit.noise_tail("a", c=0.2, delta=0.05, noise_scale=0.1, tail="gaussian"),
            audit.noise_tail("a", c=0.2, delta=0.05, noise_scale=0.1, tail="sub-gaussian"),
            audit.noise_scale("a", noise_scale=0.1, replicates=1),
            audit.sigma_reading("a", "variance"),
            audit.sigma_reading("a", "std"),
            audit.regulariser("a", "1+eta"),
            audit.regulariser("a", 1.0),
            audit.lattice_for_box("a", Lattice((0,), (1,), 3), Matern(2.5, 1.0), 0.1),
            audit.independent_problems(["a", "b"], "sum"),
            audit.workers_honest(),
            audit.centred_risk("a", 2),
            audit.norm_from_data("a", b_min=0.1, rkhs_norm=0.2, delta=0.05, noise_scale=0.1),
            audit.norm_from_data("a", b_min=0.3, rkhs_norm=0.2, delta=0.05, noise_scale=0.0),
            audit.bounds_agree("a", upper=1.0, lower=0.0),
            audit.bounds_agree("a", upper=0.0, lower=1.0),
            audit.replicate_spread("a", [(0.0, 1.0)], noise_scale=0.1, delta=0.05, planned=10),
            audit.replicate_spread("a", [], noise_scale=0.1, delta=0.05, planned=10),
            audit.deterministic_variant("a", [(0.0, 1.0)]),
            audit.deterministic_variant("a", [(1.0, 1.0)]),
            audit.deterministic_variant("a", []),
            audit.noise_range("a", noise_scale=0.1, hoeffding=0.4),
            audit.noise_range("a", noise_scale=0.4, hoeffding=0.4),
            audit.certified_box("a", nodes=0.5, slack=0.01),
            audit.misspecification("a", tau=0.0, nu=0.5, length_scale=4.0, rkhs_norm=0.15),
        ]
        for result in results:
            assert result.detail.endswith(".")
            assert ". " not in result.detail
            assert result.id.split("/")[0].isidentifier()
