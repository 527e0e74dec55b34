"""The audit: the status of each assumption, and the numbers that decided it."""

import math
import random

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.checks import audit
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from tests.fakes.observations import an_observation


def norm(y: list[float], **changed: float) -> audit.Finding:
    arguments = {"prior_mean": 0.0, "rkhs_norm": 0.1, "noise_scale": 0.05, "delta": 0.05, **changed}
    return audit.norm_from_tests(y, **arguments)


class TestNorm:
    def test_the_papers_segway_is_refuted(self) -> None:
        status, values = norm([-0.71] * 60, rkhs_norm=0.2, noise_scale=0.1)
        assert status == "refuted"
        assert values["threshold"] == pytest.approx(0.594543, abs=1e-6)
        assert (values["largest"], values["above"], values["tests"]) == (0.71, 60, 60)

    def test_threshold(self) -> None:
        threshold = 0.1 + 0.05 * math.sqrt(2 * math.log(2 * 3 / 0.05))
        assert norm([0.0, 0.0, threshold - 1e-9]).status == "not refuted"
        assert norm([0.0, 0.0, -threshold - 1e-9]).status == "refuted"

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
        with pytest.raises(ValueError, match="needs finite"):
            norm(y)


class TestRigorous:
    def test_norm_from_set(self) -> None:
        def result(b_min: float) -> audit.Finding:
            return audit.norm_from_set(b_min=b_min, rkhs_norm=0.2, confidence=0.95)

        assert result(0.21).status == "refuted"
        assert result(0.2).status == "not refuted"
        assert result(0.15).values["margin"] == pytest.approx(0.05)
        with pytest.raises(ValueError, match="b_min"):
            result(math.nan)

    def test_the_papers_test_function_is_refuted(self) -> None:
        lattice, rng = Lattice((0, 0), (5, 5), 51), np.random.default_rng(0)
        points = Points(tuple(map(tuple, lattice.nodes[rng.choice(2601, 25, replace=False)].tolist())))
        method = RigorousMethod(
            points,
            Matern(10, 1.0),
            Premises(0.25, 0.005, 0.05, mixture(0.25, 0.005)),
            alpha=0.015,
        )
        for z, (x, y) in enumerate(points.nodes):
            method.observe(*an_observation(z, math.sin(x) * math.cos(y) / 2 + rng.normal(0, 0.001)))
        assert method.bound().status == "refuted"
        assert 0.6 <= method.bound().b_min <= 1.0

    def test_bounds_agree(self) -> None:
        assert audit.bounds_agree(upper=0.5, lower=0.4).status == "not refuted"
        assert audit.bounds_agree(upper=0.4, lower=0.4 + 5e-10).status == "not refuted"
        assert audit.bounds_agree(upper=0.4, lower=0.41).status == "refuted"

    def test_replicate_spread_is_a_hint_near_r_and_a_refutation_far_above(self) -> None:
        def spread(*groups: tuple[float, ...]) -> audit.Finding | None:
            return audit.replicate_spread(groups, noise_scale=0.1, delta=0.05, planned=10)

        wide, narrow = spread((0.0, 0.3), (0.1, 0.1)), spread((0.0, 0.1))
        assert wide is not None
        assert (wide.status, wide.values["tests"]) == ("assumed", 2)
        assert wide.values["sd"] == pytest.approx(0.15)
        assert narrow is not None
        assert narrow.status == "not refuted"
        assert spread((0.0,)) is None
        with pytest.raises(ValueError, match="finite"):
            spread((0.0, math.nan))

    def test_replicate_spread_rarely_refutes_the_right_r(self) -> None:
        """Gaussian noise of sd R is R-sub-Gaussian: alarms at any of five checks in at most delta of 400 campaigns."""
        rng, alarms = np.random.default_rng(0), 0

        def status(groups: list[list[float]]) -> str:
            found = audit.replicate_spread(groups, noise_scale=0.1, delta=0.05, planned=100)
            assert found is not None
            return found.status

        for _ in range(400):
            noise = rng.normal(0.0, 0.1, (25, 4)).tolist()
            alarms += any(status(noise[:n]) == "refuted" for n in (5, 10, 15, 20, 25))
        assert alarms <= 34  # 99.9 % quantile of binomial(400, .05)
        assert status(rng.normal(0.0, 0.14, (25, 4)).tolist()) == "refuted"

    def test_deterministic_variant(self) -> None:
        assert audit.deterministic_variant([(0.5, 0.5), (0.1,)]).status == "not refuted"
        assert audit.deterministic_variant([(0.5, math.nextafter(0.5, 1))]).status == "refuted"
        assert audit.deterministic_variant([(math.nan, math.nan)]).status == "refuted"
        assert audit.deterministic_variant([(0.5,)]).status == "assumed"

    def test_noise_range(self) -> None:
        assert audit.noise_range(noise_scale=0.4, hoeffding=0.4).status == "derived"
        assert audit.noise_range(noise_scale=0.39, hoeffding=0.4).status == "assumed"


class TestOthers:
    def test_rise_between_nodes(self) -> None:
        rise = 0.25 * math.sqrt(2 - 2 * float(Matern(10, 1.0)(np.array([math.hypot(0.05, 0.05)]))[0]))
        assert audit.rise_between_nodes(Lattice((0, 0), (5, 5), 51), Matern(10, 1.0), 0.25) == pytest.approx(rise)

    def test_true_risk_is_refuted_by_derivation(self) -> None:
        assert audit.centred_risk(10) == ("refuted", {"replicates": 10, "percent": 2.7})
        with pytest.raises(ValueError, match="at least 2"):
            audit.centred_risk(1)
