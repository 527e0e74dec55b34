"""Method `paper`: its formulas, its proposals against dense linear algebra, and what it does on the test function."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.stats import binom
from sklearn.gaussian_process.kernels import Matern as ScikitMatern
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.mathematics.bounds.paper.formulas import (
    PaperParameters,
    Tail,
    beta,
    epsilon,
    eta,
    mills_probability,
    regret_bound,
    tail_probability,
)
from perfbound.orchestrator.mathematics.bounds.paper.method import PaperMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import PARTS, Lattice
from perfbound.schemas.values import Bound, Proposal
from tests.fakes.observations import an_observation

KERNEL = Matern(nu=10, length_scale=1.0)
SMALL = Lattice((0.0, 0.0), (5.0, 5.0), 11)
TAILS: tuple[Tail, ...] = ("gaussian", "sub-gaussian")


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def preset(**changed: Any) -> PaperParameters:
    """Return the parameters of the preset `test-function`, some of them changed."""
    given = {"rkhs_norm": 0.25, "noise_scale": 0.005, "delta": 0.05, "alpha": 0.015, "c": 0.01}
    return PaperParameters(**{**given, **changed})


def objective(lattice: Lattice) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.sin(lattice.nodes[:, 0]) * np.cos(lattice.nodes[:, 1]) / 2


class Run:
    """One in-process campaign on the test function, with the history of its proposals."""

    def __init__(self, lattice: Lattice, seed: int, shift: float = 0.0, max_tests: int = 200, **options: Any) -> None:
        values, rng = objective(lattice) + shift, np.random.default_rng(seed)
        self.method = PaperMethod(lattice, KERNEL, preset(**options))
        self.proposals = [self.method.propose(int(rng.integers(lattice.size)))]
        self.y = [float(values[self.proposals[0].node] + rng.normal(0, 0.001))]
        while not self.method.stops(self.proposals[-1]) and len(self.y) < max_tests:
            self.method.observe(*an_observation(self.proposals[-1].node, self.y[-1]))
            self.proposals.append(self.method.propose())
            self.y.append(float(values[self.proposals[-1].node] + rng.normal(0, 0.001)))
        self.epsilon = self.method.epsilon(self.proposals[-1], self.y[-1])


class TestFormulas:
    def test_beta(self) -> None:
        by_hand = 0.2 + 0.1 * math.sqrt(2 * math.log(math.sqrt(12.0) / 0.05))
        assert beta(math.log(12.0), rkhs_norm=0.2, noise_scale=0.1, delta=0.05) == pytest.approx(by_hand, rel=1e-14)

    def test_eta_starts_at_proposal_one(self) -> None:
        assert eta(1) == 2.0
        with pytest.raises(ValueError, match="i >= 1"):
            eta(0)

    def test_regret_bound(self) -> None:
        assert regret_bound(0.3, 0.1) == pytest.approx(0.06)

    @pytest.mark.parametrize(("c", "noise"), [(0.2, 0.1), (0.1, 0.05), (0.3, 0.15), (0.01, 0.005)])
    def test_probability_of_the_paper(self, c: float, noise: float) -> None:
        assert mills_probability(c, 0.05, noise, "gaussian") == pytest.approx(0.924354, abs=5e-7)
        assert mills_probability(c, 0.05, noise, "sub-gaussian") == pytest.approx(0.821431, abs=5e-7)

    def test_gaussian_tail_bounds_the_true_tail(self) -> None:
        for ratio in np.linspace(0.1, 6, 60):
            true = 0.5 * math.erfc(ratio / math.sqrt(2))
            assert true <= tail_probability(ratio, 1.0, "gaussian")
            assert true <= tail_probability(ratio, 1.0, "sub-gaussian")

    @given(st.floats(1e-9, 0.999), st.floats(1e-9, 0.999), st.floats(0.01, 10), st.floats(0, 10))
    def test_probability_falls_with_delta(self, one: float, other: float, c: float, noise: float) -> None:
        assume(one < other)
        for tail in TAILS:
            assert 0 <= mills_probability(c, other, noise, tail) <= mills_probability(c, one, noise, tail) <= 1

    @pytest.mark.rest
    @given(st.floats(0.01, 10), st.floats(0.01, 10), st.floats(0, 10), st.floats(0, 10))
    def test_tail_falls_with_c_and_rises_with_noise(self, c: float, more_c: float, r: float, more_r: float) -> None:
        for tail in TAILS:
            assert tail_probability(c + more_c, r, tail) <= tail_probability(c, r, tail)
            assert tail_probability(c, r, tail) <= tail_probability(c, r + more_r, tail)

    def test_no_noise_costs_no_tail(self) -> None:
        assert [tail_probability(0.1, 0.0, tail) for tail in TAILS] == [0.0, 0.0]

    @pytest.mark.parametrize(("c", "noise"), [(0.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (math.nan, 1.0), (1.0, math.inf)])
    def test_tail_refuses(self, c: float, noise: float) -> None:
        with pytest.raises(ValueError, match="c must be positive"):
            tail_probability(c, noise, "gaussian")

    @pytest.mark.parametrize("delta", [0.0, 1.0, -0.1, math.nan])
    def test_delta_is_a_probability(self, delta: float) -> None:
        with pytest.raises(ValueError, match="delta"):
            mills_probability(0.1, delta, 0.1, "gaussian")

    def test_epsilon_at_a_stop_and_at_the_budget(self) -> None:
        assert epsilon(0.5, regret=0.01, alpha=0.015, c=0.01) == pytest.approx(0.525)
        assert epsilon(0.5, regret=0.2, alpha=0.015, c=0.01) == pytest.approx(0.71)


class TestProposals:
    @pytest.mark.parametrize("sigma", ["variance", "std"])
    @pytest.mark.parametrize("regulariser", ["1+eta", 0.01])
    def test_equal_dense_linear_algebra_on_the_same_data(self, sigma: str, regulariser: str | float) -> None:
        run = Run(SMALL, seed=1, max_tests=40, alpha=1e-9, sigma=sigma, regulariser=regulariser)
        kernel = ScikitMatern(1.0, nu=10)(SMALL.nodes)
        assert len(run.proposals) == 40
        for i, proposal in enumerate(run.proposals[1:], start=1):
            before, y = [p.node for p in run.proposals[:i]], np.array(run.y[:i])
            small = kernel[np.ix_(before, before)]
            diagonal = 1 + 2 / i if regulariser == "1+eta" else float(regulariser)
            gain = np.linalg.solve(small + diagonal * np.eye(i), kernel[before]).T
            spread = 1 - np.einsum("ij,ji->i", gain, kernel[before])
            spread = spread if sigma == "variance" else np.sqrt(spread)
            determinant = np.linalg.det((1 + 2 / i) * np.eye(i) + small)
            scale = 0.25 + 0.005 * math.sqrt(2 * math.log(math.sqrt(determinant) / 0.05))
            ucb = gain @ y + scale * spread
            z = proposal.node
            assert ucb[z] == pytest.approx(ucb.max(), abs=1e-9)
            assert (proposal.mu, proposal.sigma) == pytest.approx(((gain @ y)[z], spread[z]), abs=1e-8)
            assert proposal.beta == pytest.approx(scale, abs=1e-9)
            assert pytest.approx(2 * scale * spread[z], abs=1e-8) == proposal.F
            assert proposal.x == tuple(SMALL.nodes[z])

    @pytest.mark.parametrize("sigma", ["variance", "std"])
    @pytest.mark.parametrize("regulariser", ["1+eta", 0.01])
    def test_refinement_climbs_between_the_nodes(self, sigma: Any, regulariser: Any) -> None:
        method = PaperMethod(SMALL, KERNEL, preset(sigma=sigma, regulariser=regulariser), refine=True)
        plain = PaperMethod(SMALL, KERNEL, preset(sigma=sigma, regulariser=regulariser))
        data: list[tuple[float, ...]] = []
        proposal, rng, moved = method.propose(17), np.random.default_rng(2), 0
        for i in range(1, 25):
            y = math.sin(proposal.x[0]) * math.cos(proposal.x[1]) / 2 + float(rng.normal(0, 0.001))
            data.append((*proposal.x, y))
            method.observe(*an_observation(proposal.node, y, proposal.x))
            proposal = method.propose()
            diagonal = 1 + 2 / i if regulariser == "1+eta" else float(regulariser)
            seen = np.array(data)
            gain = np.linalg.inv(ScikitMatern(1.0, nu=10)(seen[:, :2]) + diagonal * np.eye(i))

            def acquisition(where: Any, seen: Any = seen, gain: Any = gain, scale: Any = proposal.beta) -> Any:
                k = ScikitMatern(1.0, nu=10)(where, seen[:, :2])
                spread = 1 - np.einsum("ij,jk,ik->i", k, gain, k)
                return k @ gain @ seen[:, 2] + scale * (spread if sigma == "variance" else np.sqrt(spread))

            mine, best = acquisition(np.array([proposal.x]))[0], acquisition(SMALL.nodes).max()
            assert mine >= best - 1e-9
            assert (np.abs(np.subtract(proposal.x, SMALL.nodes[proposal.node])) <= 0.5 + 1e-9).all()
            moved += mine > best + 1e-6
            steps = 0.5 / PARTS * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
            around = np.clip(proposal.x + steps, 0.0, 5.0)
            inside = (np.abs(around - SMALL.nodes[proposal.node]) <= 0.5 + 1e-9).all(axis=1)
            assert mine >= acquisition(around[inside]).max() - 2e-3
        assert moved >= 5
        assert plain.propose(17) == PaperMethod(SMALL, KERNEL, preset(), refine=True).propose(17)

    def test_a_climb_that_leads_down_is_not_followed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        method = PaperMethod(SMALL, KERNEL, preset(), refine=True)
        method.observe(*an_observation(60, 0.5, tuple(SMALL.nodes[60].tolist())))
        monkeypatch.setattr(
            "perfbound.orchestrator.mathematics.bounds.paper.method.climb", lambda value, start, low, high: low
        )
        proposal = method.propose()
        assert proposal.x == tuple(SMALL.nodes[proposal.node])

    def test_the_start_is_the_callers_and_has_no_bound(self) -> None:
        method = PaperMethod(SMALL, KERNEL, preset(prior_mean=0.3))
        start = method.propose(5)
        assert start == Proposal(5, tuple(SMALL.nodes[5]), 0.3, 1.0, None, None)
        assert not method.stops(start)
        with pytest.raises(ValueError, match="at least 2"):
            method.epsilon(start, 0.1)

    def test_first_index_only_before_the_first_observation(self) -> None:
        method = PaperMethod(SMALL, KERNEL, preset())
        with pytest.raises(ValueError, match="first must be"):
            method.propose()
        with pytest.raises(IndexError):
            method.propose(SMALL.size)
        method.observe(*an_observation(5, 0.0))
        with pytest.raises(ValueError, match="first must be"):
            method.propose(5)

    def test_proposing_changes_nothing_and_a_replay_proposes_the_same(self) -> None:
        run = Run(SMALL, seed=3)
        replay = PaperMethod(SMALL, KERNEL, preset())
        for proposal, y in zip(run.proposals[:-1], run.y, strict=False):
            replay.observe(*an_observation(proposal.node, y))  # as a resume does: without proposing
        assert replay.propose() == replay.propose() == run.proposals[-1]

    def test_a_delayed_proposal_uses_the_observations_so_far(self) -> None:
        method = PaperMethod(SMALL, KERNEL, preset())
        first, second = method.propose(5), method.propose(60)  # a window of two
        assert second.F is None
        method.observe(*an_observation(first.node, 0.1))
        one = method.propose()
        method.observe(*an_observation(second.node, 0.2))
        assert one.beta is not None
        assert (method.n, one.beta < (method.propose().beta or 0)) == (2, True)

    def test_prior_mean_centres(self) -> None:
        plain, shifted = Run(SMALL, seed=4), Run(SMALL, seed=4, shift=0.7, prior_mean=0.7)
        assert [p.node for p in plain.proposals] == [p.node for p in shifted.proposals]
        assert shifted.epsilon == pytest.approx(plain.epsilon + 0.7)
        assert shifted.proposals[-1].mu == pytest.approx((plain.proposals[-1].mu or 0.0) + 0.7)

    def test_stops_at_the_tolerance(self) -> None:
        run = Run(SMALL, seed=5)
        bounds = [p.F for p in run.proposals[1:] if p.F is not None]
        assert all(f > 0.015 for f in bounds[:-1])
        assert bounds[-1] <= 0.015
        assert run.epsilon == pytest.approx(run.y[-1] + 0.025)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"rkhs_norm": 0.0},
            {"alpha": -1.0},
            {"c": 0.0},
            {"delta": 1.0},
            {"noise_scale": -1.0},
            {"prior_mean": math.nan},
            {"regulariser": -1.0},
            {"sigma": "sd"},
            {"tail": "cauchy"},
        ],
    )
    def test_refuses_parameters(self, wrong: dict[str, Any]) -> None:
        with pytest.raises(ValueError, match=next(iter(wrong))):
            PaperMethod(SMALL, KERNEL, preset(**wrong))

    def test_probability(self) -> None:
        assert PaperMethod(SMALL, KERNEL, preset()).probability == pytest.approx(0.924354, abs=5e-7)
        assert PaperMethod(SMALL, KERNEL, preset(tail="sub-gaussian")).probability < 0.83


@pytest.fixture(scope="module")
def runs() -> list[tuple[int, float]]:
    """Tests needed and bound, per seed."""
    lattice = Lattice((0.0, 0.0), (5.0, 5.0), 51)
    with threadpool_limits(1):
        return [(len(run.y), run.epsilon) for run in (Run(lattice, seed) for seed in range(150))]


class TestTestFunction:
    """The paper's first example, J* = 0.5, in 150 runs of the preset.

    [ARA] reports 50 of 50 bounds in (0.5, 0.53]. Measured here over 2,000 seeds: none above 0.53, 9.2 % below 0.5, more
    than the 7.6 % that Delta = 0.924 leaves (B = 0.25 is too small: THEORY, section 1 item 3). So the threshold on the
    share is a 99.9 % quantile at the measured rate, not at Delta.
    """

    @pytest.mark.rest
    def test_number_of_tests(self, runs: list[tuple[int, float]]) -> None:
        counts = sorted(tests for tests, _ in runs)
        assert counts[0] >= 35
        assert 40 <= counts[75] <= 50
        assert counts[-1] <= 90

    def test_no_bound_is_loose(self, runs: list[tuple[int, float]]) -> None:
        assert max(bound for _, bound in runs) <= 0.53
        assert np.median([bound for _, bound in runs]) == pytest.approx(0.519, abs=0.005)

    def test_share_of_wrong_bounds(self, runs: list[tuple[int, float]]) -> None:
        wrong = sum(bound < 0.5 for _, bound in runs)
        assert wrong <= binom.ppf(0.999, len(runs), 0.0915)
        assert min(bound for _, bound in runs) > 0.45


class TestManyAtOnce:
    def test_observations_enter_and_no_bound_follows(self) -> None:
        nodes, y = np.array([3, 60, 3]), np.array([0.1, 0.4, 0.2])
        one, other, recalled = (PaperMethod(SMALL, KERNEL, preset()) for _ in range(3))
        one.recall([an_observation(node, value) for node, value in zip(nodes.tolist(), y.tolist(), strict=True)])
        assert other.observe_each(nodes, y, y[:, None]) == Bound(None, None, None)
        recalled.recall_each(nodes, y, y[:, None])
        assert one.propose() == other.propose() == recalled.propose()

    def test_refined_starts_are_no_nodes(self) -> None:
        method = PaperMethod(SMALL, KERNEL, preset(), refine=True)
        for call in (method.observe_each, method.recall_each):
            with pytest.raises(ValueError, match="its proposal"):
                call(np.array([3]), np.zeros(1), np.zeros((1, 1)))
        assert method.n == 0
