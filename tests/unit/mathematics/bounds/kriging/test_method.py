"""Method `kriging`: design, weights against an optimiser, cells against dense points, bounds against their formula."""

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from perfbound.orchestrator.mathematics.bounds.kriging import design, weights
from perfbound.orchestrator.mathematics.bounds.kriging.bound import GuessedMean, KrigingBounds, KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.cells import PER_AXIS, NodeCells, between, has_bend
from perfbound.orchestrator.mathematics.bounds.kriging.design import (
    SHARES,
    plan_design,
    points_along,
    points_per_parameter,
)
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.bounds.kriging.weights import CAP, WeightTerms, plan_weights
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.radial import Radial
from perfbound.schemas.file import method_spaces
from perfbound.schemas.values import Observation, Proposal
from tests.fakes.observations import an_observation
from tests.fakes.states import blocks, state_of

Floats = NDArray[np.float64]
SQUARE = Lattice((0.0, 0.0), (1.0, 1.0), 9)
KERNEL = Matern(2.5, 0.8)
PREMISES = KrigingPremises(0.3, 0.7, (0.0, 1.0), 0.05)


class TestDesign:
    @pytest.mark.parametrize(("lattice", "points"), [(SQUARE, 3), (SQUARE, 5), (Lattice((0.0,) * 3, (1.0,) * 3, 4), 3)])
    def test_the_counts_are_in_proportion_after_every_test(self, lattice: Lattice, points: int) -> None:
        design = plan_design(lattice, 400, points, lattice.high)
        ends = [
            sum(k in (0, points - 1) for k in place)
            for place in itertools.product(range(points), repeat=len(lattice.low))
        ]
        shares = np.array([SHARES[each] for each in ends], dtype=float)
        counts = np.zeros(design.size)
        for test, point in enumerate(design.order, start=1):
            counts[point] += 1
            assert np.abs(counts - test * shares / shares.sum()).max() < 1.5
        assert tuple(counts) == design.counts
        corners = sum(each == len(lattice.low) for each in ends)
        assert {ends[point] for point in design.order[:corners]} == {len(lattice.low)}

    def test_points_are_the_nodes_nearest_to_equal_distances(self) -> None:
        lattice = Lattice((0.0,), (3.0,), 12)
        nodes = lattice.nodes[list(plan_design(lattice, 10, 5, lattice.high).nodes), 0]
        assert np.abs(nodes - np.linspace(0, 3, 5)).max() <= 3 / 11 / 2 + 1e-12
        assert len(set(nodes.tolist())) == 5

    def test_a_longer_budget_begins_with_the_same_tests(self) -> None:
        assert plan_design(SQUARE, 500, 4, SQUARE.high).order[:100] == plan_design(SQUARE, 100, 4, SQUARE.high).order

    def test_a_parameter_with_a_short_length_scale_has_more_points(self) -> None:
        lattice = Lattice((0.0, 0.0), (5.0, 5.0), 41)
        nodes = lattice.nodes[list(plan_design(lattice, 100, 5, (2.8, 7.7)).nodes)]
        assert (len(set(nodes[:, 0])), len(set(nodes[:, 1]))) == (8, 3)
        assert {0.0, 5.0} <= set(nodes[:, 0]) & set(nodes[:, 1])

    @given(
        st.integers(2, 9),
        st.lists(st.floats(0.01, 100.0), min_size=1, max_size=3),
        st.integers(9, 60),
    )
    def test_points_are_no_more_than_asked_for_and_fill_what_they_may(
        self, points: int, ranges: list[float], most: int
    ) -> None:
        found = points_along(points, ranges, most)
        allowed = points ** len(ranges)
        assert math.prod(found) <= allowed
        assert all(min(points, 3) <= each <= most for each in found)
        # Nowhere is room for one more.
        assert all(each == most or math.prod(found) // each * (each + 1) > allowed for each in found)

    def test_more_rollouts_have_more_points(self) -> None:
        assert [points_per_parameter(2, n, 1) for n in (20, 149, 150, 399, 400)] == [3, 3, 4, 4, 5]
        assert [points_per_parameter(3, n, 1) for n in (60, 9_999, 10_000)] == [3, 3, 4]

    def test_few_tests_have_no_more_points_than_tests(self) -> None:
        assert [points_per_parameter(2, n, 64) for n in (8, 15, 16, 24, 25)] == [3, 3, 4, 4, 5]
        assert [points_per_parameter(3, n, 200) for n in (60, 63, 64)] == [3, 3, 4]

    @pytest.mark.parametrize(("parameters", "resolution", "size"), [(4, 6, 40), (5, 5, 64), (6, 3, 96), (6, 2, 64)])
    def test_of_more_parameters_corners_come_first_and_the_rest_is_scattered(
        self, parameters: int, resolution: int, size: int
    ) -> None:
        lattice = Lattice((0.0,) * parameters, (1.0,) * parameters, resolution)
        design = plan_design(lattice, 900, 2, lattice.high)
        nodes, corners = lattice.nodes[list(design.nodes)], 2**parameters
        assert design.size == len(set(design.nodes)) == size
        assert set(map(tuple, nodes[:corners].tolist())) == set(itertools.product((0.0, 1.0), repeat=parameters))
        assert set(design.order[:corners]) == set(range(corners))
        if size > corners:
            assert design.counts[0] / design.counts[-1] == pytest.approx(6, rel=0.4)
            assert 0.2 < np.std(nodes[corners:]) < 0.45
            assert np.abs(nodes[corners:].mean(axis=0) - 0.5).max() < 0.1

    @pytest.mark.parametrize(
        ("lattice", "points"), [(SQUARE, 1), (SQUARE, 10), (Lattice((0.0,) * 7, (1.0,) * 7, 2), 2)]
    )
    def test_what_cannot_be_planned_is_refused(self, lattice: Lattice, points: int) -> None:
        with pytest.raises(ValueError, match=r"points must be|at most 6 parameters"):
            plan_design(lattice, 10, points, lattice.high)


def a_plan(tests: int = 120, points: int = 3, norm: float = 0.3) -> tuple[Floats, Floats, Floats, WeightTerms]:
    design = plan_design(SQUARE, tests, points, SQUARE.high)
    at = SQUARE.nodes[list(design.nodes)]
    radial = Radial(KERNEL)
    terms = WeightTerms(norm, 0.05, 0.1, 0.7, 0.3)
    return between(radial, SQUARE.nodes, at), between(radial, at, at), np.array(design.counts, dtype=float), terms


def loss(w: Floats, k: Floats, plan: tuple[Floats, Floats, WeightTerms], kappa: float) -> float:
    """Return what the theory minimises, written out for one node."""
    kernel, n, terms = plan
    squared = max(1.0 - 2.0 * float(w @ k) + float(w @ kernel @ w), 0.0)
    norm = math.sqrt(squared + max(terms.cell, 1e-3) ** 2)
    variance = (1.5 * terms.spread) ** 2 + (terms.rkhs_norm / 6) ** 2
    noise = variance / (2 * kappa) * float(np.sum(w * w / n))
    return terms.rkhs_norm * norm + kappa * math.log(1 / terms.delta) + noise


class TestWeights:
    @pytest.mark.parametrize("tests", [40, 400])
    @pytest.mark.parametrize("node", [0, 4, 14, 40])
    def test_they_are_as_good_as_those_of_an_optimiser(self, node: int, tests: int) -> None:
        k, kernel, n, terms = a_plan(tests)
        v, losses = plan_weights(k, kernel, n, terms)

        def least(kappa: float) -> float:
            box = [(-kappa * each * CAP / 0.3, kappa * each * CAP / 0.7) for each in n]
            found = minimize(loss, np.zeros(len(n)), (k[node], (kernel, n, terms), kappa), bounds=box, tol=1e-12)
            return float(found.fun)

        best = minimize_scalar(lambda each: least(math.exp(each)), (-7.0, -4.0), tol=1e-4).fun
        assert losses[node] == pytest.approx(best, abs=1e-3 * terms.rkhs_norm)
        assert np.all(v[node] <= CAP / 0.7)
        assert np.all(v[node] >= -CAP / 0.3)
        # The least loss of these v is that which was planned: kappa is known by it.
        own = minimize_scalar(
            lambda each: loss(math.exp(each) * n * v[node], k[node], (kernel, n, terms), math.exp(each)), (-7.0, -4.0)
        )
        assert own.fun == pytest.approx(losses[node], abs=1e-6)

    @given(st.floats(-3.0, 2.0), st.floats(-4.0, 1.0), st.floats(-2.0, 1.0), st.integers(0, 4), st.integers(1, 4))
    @settings(max_examples=30)
    def test_more_steps_win_nothing(self, norm: float, spread: float, room: float, most: int, seed: int) -> None:
        k, kernel, n, _ = a_plan()
        n = np.random.default_rng(seed).integers(1, 10**most, len(n), endpoint=True).astype(float)
        terms = WeightTerms(10.0**norm, 0.05, 10.0**spread, 10.0**room, 0.5)
        _, losses = plan_weights(k, kernel, n, terms)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(weights, "STEPS", 4 * weights.STEPS)
            _, better = plan_weights(k, kernel, n, terms)
        assert np.all(losses <= better + 0.01 * terms.rkhs_norm + 1e-2 * better)
        assert np.all(np.isfinite(losses))

    def test_they_keep_the_cap_and_leave_out_points_without_rollouts(self) -> None:
        k, kernel, n, terms = a_plan(norm=3.0)
        n[4] = 0
        v, _ = plan_weights(k, kernel, n, terms)
        assert np.all(v[:, 4] == 0)
        assert v.max() <= CAP / 0.7 + 1e-12
        assert v.min() >= -CAP / 0.3 - 1e-12
        assert v.max() > 0.99 * CAP / 0.7  # it binds
        assert v.min() < 0

    def test_symmetric_nodes_have_symmetric_weights(self) -> None:
        k, kernel, n, terms = a_plan()
        n[:] = [5, 3, 5, 3, 1, 3, 5, 3, 5]
        v = plan_weights(k, kernel, n, terms)[0].reshape(9, 9, 3, 3)
        assert np.allclose(v, v[::-1, :, ::-1, :], atol=1e-4)

    @pytest.mark.parametrize("change", [{"rkhs_norm": 0.0}, {"delta": 1.0}, {"spread": math.inf}, {"room_below": -1.0}])
    def test_bad_terms_are_refused(self, change: dict[str, float]) -> None:
        good = {"rkhs_norm": 1.0, "delta": 0.05, "spread": 0.1, "room_below": 1.0, "room_above": 1.0}
        with pytest.raises(ValueError, match=next(iter(change))):
            WeightTerms(**(good | change))


class TestCells:
    @pytest.mark.parametrize("nu", [0.5, 1.5, 2.5, 3.2])
    @pytest.mark.parametrize("dimension", [1, 2, 3, 4, 5, 6])
    def test_a_sum_of_kernels_is_not_lower_in_a_cell(self, nu: float, dimension: int) -> None:
        rng = np.random.default_rng(1)
        sides, lengths = (1.0, 2.0, 1.5, 1.0, 0.5, 1.0), (0.5, 0.9, 0.7, 0.6, 0.8, 0.5)
        lattice = Lattice((0.0,) * dimension, sides[:dimension], 4 if dimension < 4 else 3)
        radial = Radial(Matern(nu, lengths[:dimension]))
        points = lattice.nodes[rng.choice(lattice.size, 4, replace=False)]
        cells = NodeCells(lattice, radial, points)
        assert has_bend(cells.sag) == (nu > 1)
        for _ in range(10):
            w = rng.normal(size=4)
            least = sum(w[i] * cells.kernel(i) for i in range(4)).min(axis=0)
            norm = math.sqrt(float(w @ between(radial, points, points) @ w))
            z = rng.uniform(lattice.low, lattice.high, (400, dimension))
            # The nearest node in units of the spacing has the point in its cell.
            cell = np.argmin(np.max(np.abs(z[:, None] - lattice.nodes) / np.array(lattice.spacing), axis=2), axis=1)
            g = between(radial, z, points) @ w
            assert np.all(g >= least[cell] - norm * cells.reach[cell])
            assert np.all(g >= least[cell] - np.abs(w).sum() * cells.sag[cell] - 1e-12)

    def test_the_rest_is_of_use(self) -> None:
        """Where the kernel bends most it is what the kernel falls over half a step."""
        lattice = Lattice((0.0,), (1.0,), 3)
        radial = Radial(KERNEL)
        cells = NodeCells(lattice, radial, lattice.nodes)
        z = np.linspace(0.25, 0.75, 2001)[:, None]  # the cell of the middle, where the kernel of the middle bends most
        inside = between(radial, z, lattice.nodes)[:, 1]
        assert cells.sag[1] == pytest.approx(inside[1000] - inside[1000 + 125], rel=0.05)


def a_function(rng: np.random.Generator, radial: Radial, norm: float) -> tuple[Floats, Floats]:
    """Return centres and coefficients of a function of exactly this norm."""
    centres = rng.uniform(0, 1, (6, 2))
    a = rng.normal(size=6)
    return centres, a * norm / math.sqrt(float(a @ between(radial, centres, centres) @ a))


def bounds_of(points: int = 3, tests: int = 120, premises: KrigingPremises = PREMISES) -> tuple[KrigingBounds, Floats]:
    k, kernel, n, terms = a_plan(tests, points, premises.rkhs_norm)
    at = SQUARE.nodes[list(plan_design(SQUARE, tests, points, SQUARE.high).nodes)]
    cells = NodeCells(SQUARE, Radial(KERNEL), at)
    return KrigingBounds(plan_weights(k, kernel, n, terms)[0], kernel, cells, premises), at


class TestBounds:
    @pytest.mark.rest
    @given(st.integers(0, 10_000))
    @settings(max_examples=10, deadline=None)
    def test_without_noise_no_bound_exceeds_the_function_anywhere_in_its_cell(self, seed: int) -> None:
        """ln(1 + y) <= y: with X = mu the bound is certain, also with a budget at which it is tight."""
        rng, radial = np.random.default_rng(seed), Radial(KERNEL)
        centres, a = a_function(rng, radial, 0.25)
        premises = KrigingPremises(0.25, 0.6, (0.0, 1.0), 0.5)
        bounds, at = bounds_of(5, 2000, premises)
        for i, x in enumerate(at):
            value = 0.6 + float((between(radial, x[None], centres) @ a)[0])
            bounds.observe(i, [value] * 400)
        z = rng.uniform(0, 1, (2000, 2))
        cell = np.argmin(np.max(np.abs(z[:, None] - SQUARE.nodes), axis=2), axis=1)
        mu = 0.6 + between(radial, z, centres) @ a
        assert np.all(bounds.lower[cell] <= mu)
        lost = 0.6 + between(radial, SQUARE.nodes, centres) @ a - bounds.lower
        assert lost.mean() < 0.06  # .25 on average without a rollout

    def test_the_bound_is_its_formula_at_the_best_kappa(self) -> None:
        rng = np.random.default_rng(2)
        bounds, at = bounds_of()
        tests = [(int(i), rng.uniform(0.4, 0.9, 3).tolist()) for i in rng.integers(0, 9, 60)]
        for point, values in tests:
            bounds.observe(point, values)
        radial, node = Radial(KERNEL), 30
        mean, total, s, w = 0.7, 1, 0.0, np.zeros(9)
        for point, values in tests:
            for value in values:
                u = mean / total
                v = float(np.clip(bounds._planned[node, point], -CAP / (1 - u), CAP / u))
                s, mean, total = s + v * u + math.log(1 + v * (value - u)), mean + value, total + 1
                w[point] += v
        c = SQUARE.nodes[node]
        sides = [np.linspace(max(0.0, each - 1 / 16), min(1.0, each + 1 / 16), 41) for each in c]
        k = between(radial, np.array(list(itertools.product(*sides))), at)
        best = -math.inf
        for kappa in np.geomspace(1e-4, 1, 2000):
            norm = np.sqrt(1 - 2 * kappa * (k @ w) + kappa**2 * float(w @ between(radial, at, at) @ w)).max()
            best = max(best, 0.7 + kappa * (s - math.log(20) - 0.7 * w.sum()) - 0.3 * norm)
        found = float(bounds.current(PREMISES.cost)[node])
        assert best - 1e-3 <= found <= best + 1e-5

    def test_bounds_only_rise_and_an_error_changes_nothing(self) -> None:
        rng, (bounds, _) = np.random.default_rng(3), bounds_of()
        before = bounds.lower.copy()
        for _ in range(40):
            bounds.observe(int(rng.integers(9)), rng.uniform(0.3, 1.0, 2).tolist())
            assert np.all(bounds.lower >= before)
            before = bounds.lower.copy()
        sums = bounds._sum.copy()
        for wrong in ([0.5, 1.1], [math.nan]):
            with pytest.raises(ValueError, match="must be in"):
                bounds.observe(0, wrong)
        assert np.array_equal(bounds._sum, sums)
        assert bounds.rollouts == 80

    @pytest.mark.rest
    @given(st.lists(st.sampled_from([0.0, 1.0]), min_size=1, max_size=60))
    @settings(max_examples=20, deadline=None)
    def test_no_wealth_becomes_negative(self, values: list[float]) -> None:
        bounds, _ = bounds_of()
        for value in values:
            bounds.observe(0, [value])
        assert np.all(np.isfinite(bounds._sum))
        assert np.all(np.isfinite(bounds.lower))

    def test_the_guess_is_the_mean_of_the_past(self) -> None:
        guess = GuessedMean(PREMISES)
        assert guess.value == 0.7
        assert guess.before([0.1]) == [(0.7, *guess.limits_at(0.7))]
        assert guess.value == pytest.approx(0.4)
        low, high = guess.limits
        assert (1 + high * (0 - 0.4), 1 + low * (1 - 0.4)) == pytest.approx((1 - CAP, 1 - CAP))

    @pytest.mark.parametrize(
        "change", [{"rkhs_norm": -1.0}, {"prior_mean": math.nan}, {"ends": (1.0, 1.0)}, {"delta": 0.0}]
    )
    def test_bad_premises_are_refused(self, change: dict[str, object]) -> None:
        good: dict[str, object] = {"rkhs_norm": 1.0, "prior_mean": 0.0, "ends": (0.0, 1.0), "delta": 0.05}
        with pytest.raises(ValueError, match=r"must be"):
            KrigingPremises(**(good | change))  # type: ignore[arg-type]


def a_method(norm: float = 0.3, tests: int = 60, replicates: int = 4) -> KrigingMethod:
    """Return a method for J = -mu, mu in [0, 1]."""
    premises = KrigingPremises(norm, -0.7, (-1.0, 0.0), 0.05)
    return KrigingMethod(SQUARE, KERNEL, premises, spread=0.1, budget=KrigingBudget(tests, replicates, 3))


def run(method: KrigingMethod, mean: Floats, seed: int = 0) -> list[tuple[Proposal, Observation]]:
    """Run all tests; `mean` is that of each node, (m,)."""
    rng, made = np.random.default_rng(seed), []
    for _ in method.design.order:
        proposal = method.propose()
        each = tuple((-np.clip(mean[proposal.node] + 0.05 * rng.standard_normal(4), 0, 1)).tolist())
        made.append((proposal, Observation(float(np.mean(each)), each)))
        method.observe(*made[-1])
    return made


class TestMethod:
    def test_the_tests_are_those_of_the_design_with_any_in_flight(self) -> None:
        method = a_method()
        first = method.propose()
        assert first.node == method.propose(first=17).node == method.design.nodes[method.design.order[0]]
        pending = [first.node]
        assert method.propose(pending=pending).node == method.design.nodes[method.design.order[1]]
        assert method.rival(method.lattice.nodes[5].tolist()) is None
        counted = Counter(each.node for each, _ in run(method, np.full(81, 0.7)))
        assert [counted[node] for node in method.design.nodes] == list(method.design.counts)
        with pytest.raises(ValueError, match="all of them are made"):
            method.propose()

    def test_the_same_observations_rebuild_the_state_to_the_bit(self) -> None:
        first, second = a_method(), a_method()
        made = run(first, np.full(81, 0.7))
        second.recall(made[:50])
        bound = second.bound_after(made[50:])
        assert bound.upper == first.bound_after([]).upper
        assert second.bets.b_min == first.bets.b_min
        assert second.band(bound).upper == first.band(bound).upper
        assert second.band(bound).mean == first.band(bound).mean

    def test_the_bound_is_between_the_assumption_and_the_truth(self) -> None:
        method = a_method()
        before = method.bound_after([])
        assert before.upper == pytest.approx(-0.4)
        assert (before.lower, before.verdict) == (None, None)
        run(method, np.full(81, 0.7))
        bound = method.bound_after([])
        assert bound.upper is not None
        assert -0.7 < bound.upper < -0.45
        assert method.probability == 0.95
        band = method.band(bound)
        assert max(band.upper) > bound.upper  # of all cells at once, which costs more
        assert all(math.isnan(each) for each in band.lower)
        assert band.mean == pytest.approx([-0.7] * 81, abs=0.05)
        assert all(band.possible)

    def test_a_norm_that_is_far_too_small_is_refuted_and_the_bound_is_kept(self) -> None:
        hill = 0.7 + 0.25 * np.cos(np.pi * 2 * SQUARE.nodes[:, 0]) * np.cos(np.pi * 2 * SQUARE.nodes[:, 1])
        method, bounds = a_method(norm=0.1, tests=400), []
        rng = np.random.default_rng(4)
        for _ in method.design.order:
            proposal = method.propose()
            each = tuple((-np.clip(hill[proposal.node] + 0.05 * rng.standard_normal(4), 0, 1)).tolist())
            bounds.append(method.observe(proposal, Observation(0.0, each)))
        assert bounds[-1].verdict == "refuted"
        first = next(k for k, each in enumerate(bounds) if each.verdict == "refuted")
        assert {each.upper for each in bounds[first:]} == {bounds[first - 1].upper}
        assert method.bets.b_min > 0.1
        assert all(math.isnan(each) for each in method.band(bounds[-1]).upper)

    def test_a_bound_beyond_the_ball_refutes(self) -> None:
        method = a_method(norm=0.01, tests=400)
        run(method, np.full(81, 0.9))
        assert method.bets.beyond_ball
        assert method.bound_after([]).verdict == "refuted"

    def test_other_nodes_and_bad_values_are_refused(self) -> None:
        method = a_method()
        proposal = method.propose()
        elsewhere = Proposal(1, (0.0, 0.125), None, None, None, None)
        for bad, each in ((elsewhere, (-0.5,)), (proposal, ()), (proposal, (0.5,)), (proposal, (math.nan,))):
            with pytest.raises(ValueError, match=r"no point|at least one|must be in"):
                method.observe(bad, Observation(0.0, each))
        assert method.propose() == proposal
        with pytest.raises(ValueError, match="spread"):
            KrigingMethod(SQUARE, KERNEL, PREMISES, spread=0.0, budget=KrigingBudget(10, 1, 3))


class TestManyAtOnce:
    """Everything is to the bit as after one test after the other."""

    @pytest.mark.parametrize(
        ("norm", "mean", "verdict"), [(1.0, 0.7, None), (0.1, 0.7, "refuted"), (0.01, 0.9, "refuted")]
    )
    @pytest.mark.parametrize("seed", [0, 1])
    def test_any_blocks(self, norm: float, mean: float, verdict: str | None, seed: int) -> None:
        one, many, recalled, listed = (a_method(norm, tests=120) for _ in range(4))
        rng = np.random.default_rng(seed)
        nodes = np.array([one.design.nodes[point] for point in one.design.order])
        means = mean + 0.15 * np.cos(4 * np.pi * SQUARE.nodes[nodes, 0])
        each = -np.clip(means[:, None] + 0.05 * rng.standard_normal((len(nodes), 4)), 0, 1)
        for part in blocks(len(nodes), rng.integers(1, 20, 40).tolist()):
            given = nodes[part], each[part].mean(axis=1), each[part]
            tests = [an_observation(*test) for test in zip(nodes[part].tolist(), each[part].tolist(), strict=True)]
            bounds = [one.observe(*test) for test in tests]
            assert many.observe_each(*given) == listed.bound_after(tests) == bounds[-1]
            recalled.recall_each(*given)
            assert state_of(one) == state_of(many) == state_of(recalled) == state_of(listed)
            assert state_of(one.band(bounds[-1])) == state_of(many.band(bounds[-1]))
        assert bounds[-1].verdict == verdict

    def test_an_error_changes_nothing(self) -> None:
        method = a_method()
        first = method.design.nodes[0]
        method.recall_each(np.array([first]), np.zeros(1), np.full((1, 4), -0.5))
        before = state_of(method)
        good = np.full((3, 4), -0.5)
        for nodes, each in (
            ([first, 1, first], good),
            ([first] * 3, np.vstack([good[:2], [[-0.5, -0.5, -0.5, 0.5]]])),
            ([first] * 3, np.vstack([good[:2], [[-0.5, -0.5, -0.5, math.nan]]])),
            ([first] * 3, good[:, :0]),
        ):
            for call in (method.observe_each, method.recall_each):
                with pytest.raises(ValueError, match=r"no point|at least one|must be in"):
                    call(np.array(nodes), np.zeros(3), each)
            tests = [an_observation(*test) for test in zip(nodes, each.tolist(), strict=True)]
            with pytest.raises(ValueError, match=r"no point|at least one|must be in"):
                method.recall(tests)
        assert state_of(method) == before


@pytest.mark.parametrize("parameters", [4, 5])
def test_of_more_parameters_the_bound_is_true_and_shows_more_than_the_prior(parameters: int) -> None:
    """Half of `statistical`: a function of known norm, whose least value is near the least of many starts."""
    rng, ones = np.random.default_rng(parameters), (1.0,) * parameters
    lattice, kernel = Lattice((0.0,) * parameters, ones, 4), Matern(2.5, 3.0)
    radial, centres, a = Radial(kernel), rng.uniform(0, 1, (6, parameters)), rng.normal(size=6)
    a *= 0.3 / math.sqrt(float(a @ between(radial, centres, centres) @ a))
    seen = np.vstack([rng.random((5000, parameters)), list(itertools.product((0.0, 1.0), repeat=parameters))])
    largest = float((between(radial, seen, centres) @ a).max())
    method = KrigingMethod(
        lattice, kernel, KrigingPremises(0.4, 0.0, (-1.0, 1.0), 0.05), spread=0.1, budget=KrigingBudget(240, 10, 2)
    )
    for _ in range(240):
        proposal = method.propose()
        mean = float((between(radial, np.array([proposal.x]), centres) @ a)[0])
        values = np.clip(mean + 0.1 * rng.standard_normal(10), -1, 1)
        bound = method.observe(proposal, Observation(float(values.mean()), tuple(values.tolist())))
    assert bound.upper is not None
    assert largest - 1e-3 < bound.upper < largest + 0.2
    assert bound.upper < 0.4, "B and the prior mean alone"


def test_designs_and_the_campaign_file_agree_on_numbers_of_parameters() -> None:
    """The mathematics cannot import the schemas, so that both have them."""
    assert method_spaces.LATTICE_PARAMETERS == design.GRID_PARAMETERS
    assert set(method_spaces.CELLS_OF_MORE) == set(design.SCATTERED) == set(PER_AXIS) - {1, 2, 3}
