"""Method `kriging`: mean of the martingale at most 1, false claims at most as often as stated, mistakes caught.

The vectorised martingale is compared with the class first. The slow tests have the full sizes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from perfbound.orchestrator.mathematics.bounds.kriging.audit import NormAudit, PointMeans
from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingBounds, KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.cells import NodeCells, between
from perfbound.orchestrator.mathematics.bounds.kriging.design import plan_design
from perfbound.orchestrator.mathematics.bounds.kriging.weights import CAP, WeightTerms, plan_weights
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.radial import Radial

Floats = NDArray[np.float64]
Points = NDArray[np.intp]
Law = Callable[[np.random.Generator, Floats], Floats]
"""From the means of rollouts to their values in [0, 1]."""
DELTA = 0.05
RUNS = [10_000, pytest.param(100_000, marks=pytest.mark.slow)]
CAMPAIGNS = [20, pytest.param(1_000, marks=pytest.mark.slow)]


def is_at_most_one(wealth: Floats) -> bool:
    """Return whether the mean of the wealth of many runs is at most 1 + 3 standard errors."""
    return bool(wealth.mean() <= 1 + 3 * wealth.std() / math.sqrt(len(wealth)))


def allowed(count: int) -> int:
    return int(binom.ppf(0.99, count, DELTA))


# Laws with a given mean in [.6, .9], within [0, 1]


def two_points(rng: np.random.Generator, mean: Floats) -> Floats:
    return (rng.uniform(size=mean.shape) < mean).astype(np.float64)


def skewed(rng: np.random.Generator, mean: Floats) -> Floats:
    """Return falls by 2/3 with probability .15, and .1 above the mean otherwise."""
    return mean + 0.1 - (rng.uniform(size=mean.shape) < 0.15) / 1.5


def wider_where_low(rng: np.random.Generator, mean: Floats) -> Floats:
    """Return values whose variance depends on the start."""
    return mean + np.minimum(1 - mean, 1.5 * (0.9 - mean)) * rng.uniform(-1, 1, size=mean.shape)


LAWS = [two_points, skewed, wider_where_low]


# The martingale of one node


@dataclass
class Wealth:
    """R martingales of one node, with the rule of the class: `planned` weights at the points, m0 = .75, [0, 1]."""

    runs: int
    planned: Floats
    factor: float = 1.0
    count: int = 0
    total: Floats = field(init=False)
    log: Floats = field(init=False)
    sums: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.total, self.log, self.sums = np.full(self.runs, 0.75), np.zeros(self.runs), np.zeros(self.runs)

    def add(self, point: Points, value: Floats, mean: Floats, *, late: bool = False, peek: bool = False) -> None:
        """Bet on one rollout of every run; `late` takes u after the rollout, `peek` chooses v by it: both are wrong."""
        seen = self.total + value if late else self.total
        u = seen / (self.count + (2 if late else 1))
        v = np.clip(self.planned[point], -CAP / np.maximum(1 - u, 1e-300), CAP / np.maximum(u, 1e-300))
        v = np.where(value > mean, v, 0.9 * v) if peek else v
        gain = v * u + np.log1p(v * (value - u))
        self.sums += gain
        self.log += gain - v * mean + math.log(self.factor)
        self.total, self.count = self.total + value, self.count + 1


def lowest(sums: Floats, counts: Floats) -> Points:
    """Return the next point of every run: each once, then the one whose mean so far is lowest."""
    if (first := int(counts[0].sum())) < counts.shape[1]:
        return np.full(len(counts), first)
    return np.asarray(np.argmin(sums / counts, axis=1))


SIGNED = np.array([0.9, -0.8, 0.4, 1.2])
MEANS = np.array([0.62, 0.88, 0.7, 0.75])


def martingale(runs: int, law: Law, seed: int, *, steps: int = 40, factor: float = 1.0, **wrong: bool) -> Floats:
    """Return the martingales, stopped where they are first above 3, or at the end; points are chosen by outcomes."""
    rng, wealth, stopped = np.random.default_rng(seed), Wealth(runs, SIGNED, factor), np.full(runs, np.nan)
    sums, counts = np.zeros((runs, 4)), np.zeros((runs, 4))
    for _ in range(steps):
        point = lowest(sums, counts)
        value = law(rng, MEANS[point])
        wealth.add(point, value, MEANS[point], **wrong)
        sums[np.arange(runs), point] += value
        counts[np.arange(runs), point] += 1
        high = np.isnan(stopped) & (wealth.log > math.log(3))
        stopped[high] = np.exp(wealth.log[high])
    return np.where(np.isnan(stopped), np.exp(wealth.log), stopped)


class TestMartingale:
    def test_the_vectorised_rule_is_that_of_the_class(self) -> None:
        rng, problem = np.random.default_rng(1), a_problem()
        bounds = problem.bounds()
        points = rng.integers(0, 9, 50)
        values = rng.uniform(0, 1, 50)
        wealth = Wealth(1, problem.planned[7])
        for point, value in zip(points, values, strict=True):
            bounds.observe(int(point), [float(value)])
            wealth.add(np.array([point]), np.array([value]), np.zeros(1))
        assert bounds._sum[7] == pytest.approx(wealth.sums[0], rel=1e-12)

    @pytest.mark.parametrize("runs", RUNS)
    @pytest.mark.parametrize("law", LAWS)
    def test_its_mean_is_at_most_one_at_the_luckiest_moment_that_a_rule_can_choose(self, law: Law, runs: int) -> None:
        assert is_at_most_one(martingale(runs, law, 2))

    def test_a_wrong_factor_is_caught(self) -> None:
        assert not is_at_most_one(martingale(20_000, skewed, 3, factor=1.02))

    @pytest.mark.parametrize("wrong", ["late", "peek"])
    def test_a_guess_or_a_weight_from_the_rollout_itself_is_caught(self, wrong: str) -> None:
        assert not is_at_most_one(martingale(20_000, two_points, 4, **{wrong: True}))

    def test_one_start_without_bias_is_false_more_often_than_a_tenth_of_delta(self) -> None:
        rng, wealth, peak = np.random.default_rng(5), Wealth(5_000, np.array([0.3])), np.zeros(5_000)
        for _ in range(300):
            mean = np.full(5_000, 0.75)
            wealth.add(np.zeros(5_000, dtype=np.intp), two_points(rng, mean), mean)
            peak = np.maximum(peak, wealth.log)
        assert DELTA / 10 < np.mean(peak >= math.log(1 / DELTA)) <= allowed(5_000) / 5_000


# Whole claims


@dataclass(frozen=True)
class Problem:
    """A square with 9 points, and functions of norm exactly B around m0."""

    lattice: Lattice
    radial: Radial
    points: Floats
    counts: Floats
    planned: Floats
    kernel: Floats
    cells: NodeCells
    premises: KrigingPremises

    def bounds(self) -> KrigingBounds:
        return KrigingBounds(self.planned, self.kernel, self.cells, self.premises)

    def function(self, rng: np.random.Generator) -> Callable[[Floats], Floats]:
        """Return a mean whose distance from m0 has exactly the norm B."""
        centres, a = rng.uniform(0, 1, (5, 2)), rng.normal(size=5)
        a *= self.premises.rkhs_norm / math.sqrt(float(a @ between(self.radial, centres, centres) @ a))
        return lambda z: self.premises.prior_mean + between(self.radial, z, centres) @ a


def a_problem(norm: float = 0.15, tests: int = 240, resolution: int = 7, scale: float = 0.7) -> Problem:
    lattice, radial = Lattice((0.0, 0.0), (1.0, 1.0), resolution), Radial(Matern(2.5, scale))
    design = plan_design(lattice, tests, 3, lattice.high)
    points = lattice.nodes[list(design.nodes)]
    kernel, counts = between(radial, points, points), np.array(design.counts, dtype=np.float64)
    terms = WeightTerms(norm, DELTA, 0.2, 0.75, 0.25)
    planned, _ = plan_weights(between(radial, lattice.nodes, points), kernel, counts, terms)
    premises = KrigingPremises(norm, 0.75, (0.0, 1.0), DELTA)
    return Problem(lattice, radial, points, counts, planned, kernel, NodeCells(lattice, radial, points), premises)


@dataclass
class Campaign:
    """One campaign: its bounds and its audit, both observing every rollout."""

    problem: Problem

    def run(self, rng: np.random.Generator, law: Law, mean: Floats, *, adaptive: bool) -> tuple[float, float]:
        """Return the largest bound of the minimum at any moment, and B_min; `mean` is that of each point."""
        problem = self.problem
        bounds, means = problem.bounds(), PointMeans(problem.kernel, problem.premises, 0.2)
        audit = NormAudit(means, problem.counts, problem.premises, 0.2)
        order = rng.permutation(np.repeat(np.arange(len(mean)), problem.counts.astype(int)))
        best, seen = -math.inf, np.zeros(len(mean))
        for planned in order:
            point = int(planned)
            if adaptive and means.counts.min() > 0:
                point = int(np.argmin(seen / means.counts))
            (value,) = law(rng, mean[[point]])
            audit.observe(point, [float(value)])
            bounds.observe(point, [float(value)])
            means.add(point, [float(value)])
            seen[point] += value
            best = max(best, bounds.minimum())
        return best, audit.b_min


class TestClaims:
    @pytest.mark.parametrize("campaigns", CAMPAIGNS)
    @pytest.mark.parametrize("adaptive", [False, True])
    @pytest.mark.parametrize("law", LAWS)
    def test_claims_and_refutations_are_false_as_rarely_as_stated(
        self, law: Law, campaigns: int, *, adaptive: bool
    ) -> None:
        rng, problem = np.random.default_rng(6), a_problem(tests=120, resolution=5)
        dense = np.stack(np.meshgrid(*[np.linspace(0, 1, 33)] * 2), axis=-1).reshape(-1, 2)
        false = refuted = 0
        for _ in range(campaigns):
            mu = problem.function(rng)
            best, b_min = Campaign(problem).run(rng, law, mu(problem.points), adaptive=adaptive)
            false += best > mu(dense).min()
            refuted += b_min > problem.premises.rkhs_norm
        assert false <= allowed(campaigns)
        assert refuted <= allowed(campaigns)

    @pytest.mark.parametrize("campaigns", [20, pytest.param(200, marks=pytest.mark.slow)])
    def test_a_norm_that_is_four_times_too_small_is_refuted(self, campaigns: int) -> None:
        """Rough functions, with values of little noise: the audit has power."""
        rng, rough, refuted = np.random.default_rng(7), a_problem(norm=0.4, tests=600, scale=0.3), 0
        assumed = a_problem(norm=0.1, tests=600, scale=0.3)
        for _ in range(campaigns):
            mean = np.clip(rough.function(rng)(assumed.points), 0.05, 0.95)
            _, b_min = Campaign(assumed).run(rng, little_noise, mean, adaptive=False)
            refuted += b_min > 0.1
        assert refuted > 0.5 * campaigns

    def test_bounds_with_too_small_a_norm_are_caught(self) -> None:
        """The norm enters: with a tenth of it claims are false far more often than stated."""
        rng, problem, false = np.random.default_rng(8), a_problem(norm=0.015), 0
        rough = a_problem(norm=0.4)
        dense = np.stack(np.meshgrid(*[np.linspace(0, 1, 33)] * 2), axis=-1).reshape(-1, 2)
        for _ in range(20):
            mu = rough.function(rng)
            mean = np.clip(mu(problem.points), 0.05, 0.95)
            false += Campaign(problem).run(rng, little_noise, mean, adaptive=False)[0] > mu(dense).min()
        assert false > allowed(20)


def little_noise(rng: np.random.Generator, mean: Floats) -> Floats:
    return mean + 0.05 * rng.uniform(-1, 1, size=mean.shape)
