"""Method `rigorous` against dense linear algebra, exact arithmetic and functions of known norm."""

import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from decimal import MIN_EMIN, Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process.kernels import Matern as ScikitMatern
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.mathematics.bounds.rigorous.box_maximum import certified_maximum
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import (
    Mixture,
    Premises,
    mixture,
    radius,
    scales_squared,
)
from perfbound.orchestrator.mathematics.bounds.rigorous.method import ExhaustedError, RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.observations import Observations
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.orchestrator.mathematics.gp.radial import Radial
from perfbound.orchestrator.mathematics.gp.spectrum import Spectrum, decompose
from tests.fakes.observations import an_observation

LATTICE = Lattice((0.0, 0.0), (5.0, 5.0), 7)
KERNEL = Matern(nu=2.5, length_scale=2.0)
DENSE = ScikitMatern(2.0, nu=2.5)(LATTICE.nodes)  # (m, m)
MIX: Mixture = ((0.01, 0.5), (0.1, 0.5))
FINE = np.stack(np.meshgrid(np.linspace(0, 5, 61), np.linspace(0, 5, 61), indexing="ij"), axis=-1).reshape(-1, 2)

data = st.lists(st.tuples(st.integers(0, LATTICE.size - 1), st.floats(-1, 1)), min_size=1, max_size=25)


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def make(candidates: Lattice | Points = LATTICE, kernel: Matern = KERNEL, **changed: Any) -> RigorousMethod:
    """Build the method; `changed` names parameters of the premises or of the method itself."""
    assumed = {field.name: changed.pop(field.name) for field in fields(Premises) if field.name in changed}
    premises = Premises(**{"rkhs_norm": 1.0, "noise_scale": 0.1, "delta": 0.1, "regularisers": MIX, **assumed})
    return RigorousMethod(candidates, kernel, premises, **{"alpha": 0.05, **changed})


def exactly(norm: float, seed: int, kernel: Matern = KERNEL) -> Callable[[Floats], Floats]:
    """A random function whose norm is `norm`, evaluated by scikit-learn."""
    rng = np.random.default_rng(seed)
    centres, weights = rng.uniform(0, 5, (8, 2)), rng.normal(size=8)
    oracle = ScikitMatern(kernel.length_scale, nu=kernel.nu)
    weights *= norm / math.sqrt(weights @ oracle(centres) @ weights)
    return lambda z: np.asarray(oracle(z, centres) @ weights, dtype=np.float64)


def run(method: RigorousMethod, values: Floats, noise: Callable[[], float], tests: int, window: int = 1) -> list[int]:
    """A campaign of `tests` tests; the proposals in order."""
    flying, done = [method.propose(3).node], list[int]()
    while len(done) < tests:
        while len(flying) < window:
            flying.append(method.propose(None, flying).node)
        z = flying.pop(0)
        method.observe(*an_observation(z, float(values[z]) + noise()))
        done.append(z)
        if window == 1:
            flying.append(method.propose().node)
    return done


def dense_scales(indices: list[int], y: Floats, premises: Premises, a: float) -> float:
    """The naive form of g_a^2, from the n x n matrix."""
    k, eye, n = DENSE[np.ix_(indices, indices)], np.eye(len(y)), len(y)
    r2 = premises.noise_scale**2
    if r2:
        total = sum(
            w * math.exp(-np.linalg.slogdet(eye + k / v)[1] / 2 - v * y @ np.linalg.solve(k + v * eye, y) / (2 * r2))
            for v, w in premises.regularisers
        )
        q = 2 * r2 * (math.log(1 / premises.delta) - math.log(total))
    else:
        q = n * premises.round_off**2
    q = (math.sqrt(q) + premises.tau * math.sqrt(n)) ** 2
    return float(premises.rkhs_norm**2 + q / a - y @ np.linalg.solve(k + a * eye, y))


class TestSpectrum:
    @given(data, st.sampled_from([0.01, 0.3, 2.0]))
    @settings(deadline=None, max_examples=40)
    def test_merging_is_exact(self, observed: list[tuple[int, float]], a: float) -> None:
        indices, y = [i for i, _ in observed], np.array([v for _, v in observed])
        merged = Observations(LATTICE.kernel_rows(KERNEL))
        for index, value in observed:
            merged.append(index, value)
        spectrum, k = decompose(merged), DENSE[np.ix_(indices, indices)]
        inverse = np.linalg.inv(k + a * np.eye(len(y)))
        assert spectrum.energy(a) + spectrum.within / a == pytest.approx(y @ inverse @ y, rel=1e-8, abs=1e-10)
        assert spectrum.information(a) == pytest.approx(np.linalg.slogdet(np.eye(len(y)) + k / a)[1], abs=1e-9)
        w = spectrum.projector @ merged.points.kernel
        shrunk = 1 / (spectrum.values + a)
        np.testing.assert_allclose(w.T @ (spectrum.u * shrunk), DENSE[:, indices] @ inverse @ y, atol=1e-9)
        variance = 1 - np.einsum("ij,jk,ik->i", DENSE[:, indices], inverse, DENSE[:, indices])
        np.testing.assert_allclose(1 - (w * w).T @ shrunk, variance, atol=1e-9)


class TestScale:
    @given(data, st.sampled_from([0.0, 0.05]), st.sampled_from([0.02, 0.1, 5.0]))
    @settings(deadline=None, max_examples=40)
    def test_equals_the_naive_form(self, observed: list[tuple[int, float]], tau: float, a: float) -> None:
        premises = Premises(1.0, 0.1, 0.1, MIX, tau)
        merged = Observations(LATTICE.kernel_rows(KERNEL))
        for index, value in observed:
            merged.append(index, value)
        naive = dense_scales([i for i, _ in observed], np.array([v for _, v in observed]), premises, a)
        ours = float(scales_squared(decompose(merged), premises, np.array([a]))[0])
        assert ours == pytest.approx(naive, rel=1e-6, abs=1e-6)

    @pytest.mark.parametrize("tau", [0.0, 1e-7])
    def test_equals_the_naive_form_in_60_digits_where_doubles_fail(self, tau: float) -> None:
        rng = np.random.default_rng(0)
        e, u = np.array([3.0, 0.5, 1e-3, 1e-9]), rng.normal(size=4) * np.array([3.0, 0.5, 0.001, 1e-6])
        spectrum, mix = Spectrum(500, e, np.eye(4), u, 1e6, 0.0), ((1e-8, 0.5), (1e-6, 0.25), (1e-4, 0.25))
        premises, a = Premises(2.0, 1e-5, 0.05, mix, tau), 1e-7
        with localcontext() as context:
            context.prec, context.Emin = 60, MIN_EMIN
            d = Decimal
            r2, n = d(1e-5) ** 2, d(500)

            def quadratic(x: float) -> Decimal:
                terms = zip(u.tolist(), e.tolist(), strict=True)
                return sum((d(ui) ** 2 / (d(ei) + d(x)) for ui, ei in terms), start=d(0)) + d(1e6) / d(x)

            def information(x: float) -> Decimal:
                return sum(((1 + d(ei) / d(x)).ln() for ei in e.tolist()), start=d(0))

            total = sum(
                (d(w) * (-information(v) / 2 - d(v) * quadratic(v) / (2 * r2)).exp() for v, w in mix), start=d(0)
            )
            q = ((2 * r2 * ((1 / d(0.05)).ln() - total.ln())).sqrt() + d(tau) * n.sqrt()) ** 2
            exact = float(d(4) + q / d(a) - quadratic(a))
        ours = float(scales_squared(spectrum, premises, np.array([a]))[0])
        doubles = 4.0 + radius(spectrum, premises) / a - (spectrum.energy(a) + spectrum.within / a)
        assert ours == pytest.approx(exact, rel=1e-9)
        assert abs(doubles - exact) > 1e-4

    def test_never_above_abbasi_yadkori(self) -> None:
        lam = 0.05
        method = make(regularisers=((lam, 1.0),))
        chosen: list[int] = []
        rng, y = np.random.default_rng(2), []
        for z in [3, 9, 9, 30, 41, 20, 3]:
            y.append(float(rng.normal()) * 0.3)
            method.observe(*an_observation(z, y[-1]))
            chosen.append(z)
            k = DENSE[np.ix_(chosen, chosen)]
            inverse = np.linalg.inv(k + lam * np.eye(len(y)))
            mu = DENSE[:, chosen] @ inverse @ np.array(y)
            sd = np.sqrt(1 - np.einsum("ij,jk,ik->i", DENSE[:, chosen], inverse, DENSE[:, chosen]))
            gamma = np.linalg.slogdet(np.eye(len(y)) + k / lam)[1]
            scale = 1.0 + 0.1 / math.sqrt(lam) * math.sqrt(gamma + 2 * math.log(10))
            upper, lower = method.envelope.at(LATTICE.nodes)
            assert (upper <= mu + scale * sd + 1e-9).all()
            assert (lower >= mu - scale * sd - 1e-9).all()
        assert method.bound().n == 7

    @pytest.mark.parametrize("noise", [0.1, 0.0])
    def test_band_equals_brute_force(self, noise: float) -> None:
        premises = Premises(1.0, noise, 0.1, MIX)
        candidates = Points(tuple(map(tuple, LATTICE.nodes.tolist())))
        method, values = make(candidates, noise_scale=noise), exactly(0.9, 5)(LATTICE.nodes)
        indices, y = [1, 8, 40, 17, 30], []
        best = (math.inf, -math.inf)
        for n, z in enumerate(indices, start=1):
            y.append(float(values[z]))
            method.observe(*an_observation(z, y[-1]))
            uppers, lowers = [np.full(LATTICE.size, 1.0)], [np.full(LATTICE.size, -1.0)]
            for a in premises.grid():
                k = DENSE[np.ix_(indices[:n], indices[:n])] + a * np.eye(n)
                gain = np.linalg.solve(k, DENSE[indices[:n]]).T
                sd = np.sqrt(np.maximum(1 - np.einsum("ij,ji->i", gain, DENSE[indices[:n]]), 0))
                g = math.sqrt(dense_scales(indices[:n], np.array(y), premises, float(a)))
                uppers.append(gain @ np.array(y) + g * sd)
                lowers.append(gain @ np.array(y) - g * sd)
            best = (
                min(best[0], float(np.min(uppers, axis=0).max())),
                max(best[1], float(np.max(lowers, axis=0).max())),
            )
            assert (method.bound().upper, method.bound().lower) == pytest.approx(best, abs=1e-6)

    def test_default_mixture(self) -> None:
        assert mixture(1.5, 0.005)[0] == (1.1e-5, 0.25)
        assert mixture(1.5, 0.0) == ()
        assert mixture(1.0, 1e-9)[0][0] == 1e-9


class TestTruth:
    @pytest.mark.rest
    @pytest.mark.parametrize(("nu", "length"), [(0.5, 4.0), (1.5, 2.0), (2.5, 2.0), (10.0, 2.0)])
    def test_without_noise_the_bound_is_certain(self, nu: float, length: float) -> None:
        kernel = Matern(nu, length)
        for seed in range(4):
            j = exactly(1.0, seed, kernel)
            method = make(kernel=kernel, noise_scale=0.0, prior_mean=0.3, alpha=1e-6)
            values, top = j(LATTICE.nodes) + 0.3, float(j(FINE).max()) + 0.3
            for z in [5, *range(0, 49, 6)]:
                method.observe(*an_observation(z, float(values[z])))
                bound = method.bound()
                assert bound.lower <= top + 1e-9
                assert bound.upper >= top - 1e-9
                assert bound.status == "open"
                upper, lower = method.envelope.at(FINE)
                assert (lower - 1e-9 <= j(FINE) + 0.3).all()
                assert (j(FINE) + 0.3 <= upper + 1e-9).all()
            assert method.probability == 1.0
            assert bound.b_min <= 1.0

    def test_with_noise_the_band_holds_and_narrows(self) -> None:
        j, rng = exactly(1.0, 11), np.random.default_rng(0)
        method = make()
        start = method.bound()
        run(method, j(LATTICE.nodes), lambda: float(rng.choice([-0.1, 0.1])), 60)
        bound, (upper, lower) = method.bound(), method.envelope.at(FINE)
        assert (lower <= j(FINE)).all()
        assert (j(FINE) <= upper).all()
        assert bound.lower <= j(FINE).max() <= bound.upper
        assert bound.upper - bound.lower < 0.5 * (start.upper - start.lower)
        assert bound.slack == bound.upper - bound.candidates_upper > 0
        assert method.probability == 0.9

    def test_misspecification(self) -> None:
        j, tau = exactly(1.0, 3), 0.05
        values = j(LATTICE.nodes) + tau * np.sign(np.sin(50 * LATTICE.nodes[:, 0]))
        method = make(noise_scale=0.0, tau=tau)
        for z in range(0, 49, 4):
            method.observe(*an_observation(z, float(values[z])))
            upper, lower = method.envelope.at(LATTICE.nodes)
            assert (lower <= values).all()
            assert (values <= upper).all()
        assert method.bound().status == "open"

    @given(data, st.floats(0.01, 0.5), st.floats(1.0, 4.0))
    @settings(deadline=None, max_examples=25)
    def test_monotone_in_delta_and_b(self, observed: list[tuple[int, float]], delta: float, factor: float) -> None:
        # One a-grid for all, so that only the theorem differs.
        merged = Observations(LATTICE.kernel_rows(KERNEL))
        for index, value in observed:
            merged.append(index, value)
        spectrum, a = decompose(merged), np.array([0.01, 0.1, 1.0])
        base = scales_squared(spectrum, Premises(1.0, 0.1, delta, MIX), a)
        assert (scales_squared(spectrum, Premises(1.0, 0.1, delta / factor, MIX), a) >= base - 1e-12).all()
        assert (scales_squared(spectrum, Premises(factor, 0.1, delta, MIX), a) >= base - 1e-12).all()

    def test_a_finite_list_has_no_slack_and_converges(self) -> None:
        points = Points(((0.5, 0.5), (1.5, 0.5), (4.0, 4.0)))
        j = exactly(1.0, 2)(points.nodes)
        method = make(points, noise_scale=0.0, alpha=1e-4)
        z = method.propose(1)
        while method.bound().status == "open":
            method.observe(*an_observation(z.node, float(j[z.node])))
            if method.bound().status == "open":
                z = method.propose()
        bound = method.bound()
        assert (bound.status, bound.slack) == ("converged", 0.0)
        assert bound.upper == pytest.approx(j.max(), abs=1e-4)
        assert method.bound().n <= 3


class TestRefutation:
    @pytest.mark.rest
    def test_b_four_times_too_small_is_refuted_and_never_converges(self) -> None:
        refuted = 0
        for seed in range(10):
            j, rng = exactly(1.0, seed), np.random.default_rng(seed)
            method = make(rkhs_norm=0.25, noise_scale=0.02, regularisers=mixture(0.25, 0.02))
            seen = []
            flying = method.propose(seed)
            for _ in range(40):
                method.observe(
                    *an_observation(flying.node, float(j(LATTICE.nodes[[flying.node]])[0] + rng.normal(0, 0.02)))
                )
                seen.append(method.bound().status)
                flying = method.propose()
            if "refuted" in seen:
                refuted += 1
                assert set(seen[seen.index("refuted") :]) == {"refuted"}
                assert method.bound().b_min > 0.25 or method.bound().upper < method.bound().lower - 1e-9
        assert refuted >= 8

    def test_an_impossible_observation_without_noise(self) -> None:
        method = make(noise_scale=0.0)
        method.observe(*an_observation(3, 0.5))
        assert method.bound().b_min == pytest.approx(0.5, abs=1e-6)
        before = method.bound()
        method.observe(*an_observation(3, 0.6))
        after = method.bound()
        assert after.status == "refuted"
        assert (after.upper, after.lower) == (before.upper, before.lower)
        method.observe(*an_observation(4, 0.5))
        assert method.bound().status == "refuted"

    @pytest.mark.parametrize("noise", [0.0, 0.1])
    def test_an_absurd_observation(self, noise: float) -> None:
        method = make(noise_scale=noise)
        method.observe(*an_observation(3, 1e99))
        assert method.bound().status == "refuted"
        assert math.isfinite(method.bound().upper)

    def test_replicates_without_noise_must_agree(self) -> None:
        method = make(noise_scale=0.0)
        for _ in range(3):
            method.observe(*an_observation(3, 0.5))
        assert method.bound().status == "open"


class TestCover:
    @pytest.mark.parametrize(("nu", "length"), [(0.5, 2.0), (0.5, 4.0), (0.8, 2.0), (1.5, 2.0)])
    def test_rough_kernels_cover_the_band_itself(self, nu: float, length: float) -> None:
        kernel = Matern(nu, length)
        j = exactly(0.5, 7, kernel)(LATTICE.nodes)
        method = make(kernel=kernel, noise_scale=0.0)
        for z in range(0, 49, 5):
            method.observe(*an_observation(z, float(j[z])))
            nodes = float(method.envelope.at(LATTICE.nodes)[0].max())
            cover = certified_maximum((method.envelope,), LATTICE, nodes=nodes, slack=0.01, max_cells=20_000)
            fine = float(method.envelope.at(FINE)[0].max())
            assert fine <= cover.upper <= cover.found + 0.01
            assert nodes <= cover.found
            assert cover.found <= fine + 0.02

    @pytest.mark.parametrize("nu", [2.2, 2.5, 10.0])
    def test_smooth_kernels_cover_every_function(self, nu: float) -> None:
        kernel = Matern(nu, 1.5)
        for seed in range(5):
            j = exactly(1.0, seed, kernel)
            method = make(kernel=kernel, noise_scale=0.0)
            for z in range(0, 49, 3):
                method.observe(*an_observation(z, float(j(LATTICE.nodes[[z]])[0])))
            nodes = float(method.envelope.at(LATTICE.nodes)[0].max())
            cover = certified_maximum((method.envelope,), LATTICE, nodes=nodes, slack=0.005, max_cells=20_000)
            assert j(FINE).max() <= cover.upper <= cover.found + 0.005

    def test_a_budget_of_cells_keeps_the_bound_valid(self) -> None:
        method = make(kernel=Matern(0.5, 2.0), noise_scale=0.0)
        method.observe(*an_observation(24, 0.2))
        coarse, fine = (
            certified_maximum((method.envelope,), LATTICE, nodes=0.0, slack=1e-3, max_cells=cells)
            for cells in (40, 20_000)
        )
        assert coarse.cells == 36
        assert coarse.upper >= fine.upper

    def test_one_and_three_dimensions(self) -> None:
        for dimension in (1, 3):
            lattice = Lattice((0.0,) * dimension, (1.0,) * dimension, 4)
            for nu in (0.5, 2.5):
                method = make(lattice, Matern(nu, 1.0), noise_scale=0.0)
                method.observe(*an_observation(0, 0.5))
                method.observe(*an_observation(lattice.size - 1, 0.4))
                assert 0.5 <= method.bound().upper <= 1.0


class TestProposals:
    def test_first_index(self) -> None:
        method = make(prior_mean=0.2)
        first = method.propose(5)
        assert (first.node, first.mu, first.sigma, first.beta, first.F) == (5, 0.2, 1.0, None, None)
        with pytest.raises(ValueError, match="first must be"):
            method.propose()
        with pytest.raises(ValueError, match="first must be"):
            method.propose(4, [5])
        with pytest.raises(IndexError):
            method.propose(49)
        with pytest.raises(IndexError):
            method.propose(None, [49])

    @pytest.mark.parametrize("noise", [0.0, 0.1])
    def test_a_window_of_eight_spreads(self, noise: float) -> None:
        method = make(noise_scale=noise)
        flying = [24]
        while len(flying) < 8:
            flying.append(method.propose(None, flying).node)
        assert len(set(flying)) == 8
        method.observe(*an_observation(24, 0.3))
        more = flying[1:]
        while len(more) < 8:
            more.append(method.propose(None, more).node)
        assert len({*more, 24}) == 9 if noise == 0 else len(set(more)) >= 7

    def test_pending_variance_is_that_after_observing(self) -> None:
        method, y = make(regularisers=((0.05, 1.0),)), 0.1
        for z in (3, 20, 20):
            method.observe(*an_observation(z, y))
        proposal = method.propose(None, [40, 7, 40])
        later = make(regularisers=((0.05, 1.0),))
        for z in (3, 20, 20, 40, 7, 40):
            later.observe(*an_observation(z, y))
        # The a of the proposal follows from its beta alone; search the sigma among the grid's.
        _, sd = later.envelope.moments(method._rows.row(proposal.node)[[3, 20, 40, 7]][:, None])
        assert float(np.abs(sd[0] - proposal.sigma).min()) < 1e-7

    def test_without_noise_nothing_is_observed_twice(self) -> None:
        method, values = make(noise_scale=0.0, alpha=1e-9), exactly(0.9, 1)(LATTICE.nodes)
        z = method.propose(0)
        for _ in range(LATTICE.size - 1):
            method.observe(*an_observation(z.node, float(values[z.node])))
            z = method.propose()
        method.observe(*an_observation(z.node, float(values[z.node])))
        with pytest.raises(ExhaustedError, match="Raise the resolution"):
            method.propose()

    @pytest.mark.parametrize("window", [1, 8])
    def test_a_replay_has_the_same_bits(self, window: int) -> None:
        rng, values = np.random.default_rng(0), exactly(1.0, 4)(LATTICE.nodes)
        noise = rng.normal(0, 0.1, 30).tolist()
        live, replayed = make(), make()
        order = run(live, values, iter(noise).__next__, 30, window)
        for z, error in zip(order, noise, strict=True):
            replayed.observe(*an_observation(z, float(values[z]) + error))
        assert live.bound() == replayed.bound()
        assert live.propose(None, [1]) == live.propose(None, [1]) == replayed.propose(None, [1])

    def test_an_error_changes_nothing(self) -> None:
        method = make()
        for index, y, error in ((0, math.nan, ValueError), (0, 1e200, ValueError), (99, 0.0, IndexError)):
            with pytest.raises(error):
                method.observe(*an_observation(index, y))
        assert method.bound().n == 0

    @pytest.mark.parametrize(
        "wrong",
        [
            {"rkhs_norm": 0.0},
            {"noise_scale": -1.0},
            {"delta": 1.0},
            {"alpha": 0.0},
            {"regularisers": ()},
            {"regularisers": ((0.0, 1.0),)},
            {"regularisers": ((0.1, 0.0),)},
            {"regularisers": ((0.1, 0.6), (1.0, 0.6))},
            {"prior_mean": math.inf},
            {"tau": -0.1},
            {"round_off": math.nan},
            {"slack": 1.0},
        ],
    )
    def test_refuses_parameters(self, wrong: dict[str, Any]) -> None:
        with pytest.raises(ValueError, match=next(iter(wrong))):
            make(**wrong)


class TestPoints:
    @pytest.mark.parametrize(
        ("points", "message"),
        [
            ((), "at least one"),
            (((0.0, 1.0), (2.0,)), "1 coordinates"),
            (((0.0, math.nan),), "finite"),
            (((0.0, 1.0), (1.0, 1.0), (0.0, 1.0)), "points 0 and 2 are the same"),
        ],
    )
    def test_refuses(self, points: tuple[tuple[float, ...], ...], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            Points(points)

    def test_rows(self) -> None:
        points = Points(tuple(map(tuple, LATTICE.nodes.tolist())))
        rows = points.kernel_rows(KERNEL)
        np.testing.assert_allclose([rows.row(i) for i in range(49)], DENSE, atol=1e-14)
        with pytest.raises(IndexError):
            rows.row(-1)


class TestRadial:
    def test_refuses_what_overflows(self) -> None:
        with pytest.raises(ValueError, match="smaller nu"):
            Radial(Matern(41.0, 1.0))

    r = np.concatenate([[1e-9, 1e-3], np.linspace(0.01, 12, 400)])

    @pytest.mark.parametrize("nu", [0.3, 0.5, 1.0, 1.5, 2.2, 2.5, 3.5, 10.0, 20.0])
    def test_value_slope_and_curvature(self, nu: float) -> None:
        radial, kernel = Radial(Matern(nu, 1.3)), ScikitMatern(1.3, nu=nu)
        np.testing.assert_allclose(radial.value(self.r), kernel(self.r[:, None], np.zeros((1, 1)))[:, 0], atol=1e-12)
        step, r = 1e-4, np.linspace(0.2, 8, 50)
        ahead, here, behind = (radial.value(r + d) for d in (step, 0.0, -step))
        np.testing.assert_allclose(radial.slope(r) * r, (ahead - behind) / (2 * step), atol=1e-6)
        second = np.abs(ahead - 2 * here + behind) / step**2
        assert (second <= radial.curvature(r - 0.1, r + 0.1) + 1e-4).all()
        assert (np.abs(radial.slope(r)) <= radial.curvature(r - 0.1, r + 0.1)).all()

    @pytest.mark.parametrize("nu", [0.3, 0.5, 1.0, 1.5, 2.2, 2.5, 3.5, 10.0, 20.0])
    def test_climbing_uses_the_same_value_and_nearly_the_same_slope(self, nu: float) -> None:
        radial = Radial(Matern(nu, 1.3))
        value, slope = radial.value_and_slope(self.r)
        np.testing.assert_allclose(value, radial.value(self.r), atol=1e-15)
        np.testing.assert_allclose(slope * self.r, radial.slope(self.r) * self.r, atol=1e-8 * radial.rate)
        assert radial.value_and_slope(np.zeros(1))[1] == 0.0

    def test_bend_is_the_root_of_the_fourth_derivative(self) -> None:
        h, radial = 0.02, Radial(Matern(10.0, 1.3))
        k = radial.value(np.array([0.0, h, 2 * h]))
        assert (6 * k[0] - 8 * k[1] + 2 * k[2]) / h**4 == pytest.approx(radial.bend**2, rel=0.01)
        assert Radial(Matern(2.0, 1.0)).bend == math.inf

    def test_distance(self) -> None:
        assert Radial(Matern(0.5, 2.0)).distance(2.0) == pytest.approx(math.sqrt(2 - 2 / math.e))
