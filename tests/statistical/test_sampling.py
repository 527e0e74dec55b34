"""Method `sample`: mean wealth at most 1, false claims at most as often as stated, power, and mistakes caught.

`ever` counts a claim as false if it was false at any n: no stop that depends on outcomes can be worse. The study of
`make coverage` has the classes themselves on the same laws.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import bdtr
from scipy.stats import binom

from perfbound.orchestrator.mathematics.bounds.one_law.failures import (
    FailureSequence,
    QuantileSequence,
    beta_mixture_upper,
    log_wealth_above,
    log_wealth_below,
)
from perfbound.orchestrator.mathematics.bounds.one_law.predictable import (
    CvarSequence,
    PredictableSequence,
    RiskSequence,
)
from perfbound.orchestrator.mathematics.bounds.one_law.share import (
    clopper_pearson_lower,
    clopper_pearson_upper,
    next_rollout_rank,
    quantile_rank,
)
from perfbound.orchestrator.mathematics.bounds.rounding import ROUND_OFF
from perfbound.orchestrator.mathematics.bounds.sample import SampleMethod, Terms
from perfbound.schemas.values import Observation, SampledQuantity
from tests.statistical.vectorised import DELTA, cvar_wealth, mixture_wealth, risk_wealth

Floats = NDArray[np.float64]
RUNS = 1_000
ALLOWED = int(binom.ppf(0.99, RUNS, DELTA))  # 67
SIZES = [10_000, pytest.param(100_000, marks=pytest.mark.slow)]


def is_at_most_one(wealth: Floats) -> bool:
    """Return whether the mean of the wealth of many runs is at most 1 + 3 standard errors."""
    return bool(wealth.mean() <= 1 + 3 * wealth.std() / math.sqrt(len(wealth)))


def ever(log_wealth: Floats) -> int:
    """Return the runs (R, n) whose wealth rejects at some n."""
    return int(np.count_nonzero(log_wealth.max(axis=1) >= math.log((1 + ROUND_OFF) / DELTA)))


def records(seed: int, p: float, n: int, runs: int = RUNS) -> NDArray[np.bool_]:
    """Return whether each sample (R, n) fails."""
    return np.asarray(np.random.default_rng(seed).uniform(size=(runs, n)) < p)


class TestFailureProbability:
    @pytest.mark.parametrize("p", [0.003, 0.3, 0.99])
    def test_the_vectorised_rule_is_that_of_the_functions(self, p: float) -> None:
        for above, wealth in ((True, log_wealth_above), (False, log_wealth_below)):
            failed = records(1, p, 200, 5)
            found = mixture_wealth(failed, p, above=above)
            for row, values in zip(failed, found, strict=True):
                expected = [wealth(p, int(row[:n].sum()), n) for n in range(1, 201)]
                assert values == pytest.approx(expected, abs=1e-9)

    @pytest.mark.parametrize("p", [0.001, 0.01, 0.1, 0.5, 0.9, 0.999])
    @pytest.mark.parametrize("above", [True, False])
    def test_false_claims_of_a_thousand_campaigns(self, above: bool, p: float) -> None:
        assert ever(mixture_wealth(records(2, p, 500), p, above=above)) <= ALLOWED

    @pytest.mark.parametrize("runs", SIZES)
    @pytest.mark.parametrize("p", [0.05, 0.5, 0.95])
    @pytest.mark.parametrize("above", [True, False])
    def test_the_mean_wealth_is_at_most_one(self, above: bool, p: float, runs: int) -> None:
        assert is_at_most_one(np.exp(mixture_wealth(records(3, p, 30, runs), p, above=above)[:, -1]))

    @pytest.mark.parametrize("above", [True, False])
    def test_a_tight_case_is_false_more_often_than_a_tenth_of_delta(self, above: bool) -> None:
        assert ever(mixture_wealth(records(4, 0.5, 500), 0.5, above=above)) > RUNS * DELTA / 10

    def test_a_wrong_factor_is_caught(self) -> None:
        """The Beta function without its exponent a: twice the wealth. A candidate .01 beyond the truth."""
        failed = records(3, 0.05, 30, 20_000)
        assert not is_at_most_one(2 * np.exp(mixture_wealth(failed, 0.05)[:, -1]))
        assert not is_at_most_one(np.exp(mixture_wealth(failed, 0.06)[:, -1]))
        assert not is_at_most_one(np.exp(mixture_wealth(failed, 0.035, above=False)[:, -1]))

    def test_clopper_pearson_with_a_stop_that_depends_on_outcomes_is_caught(self) -> None:
        """The least of its bounds after 100 .. 1,000 samples: what the betting bound is for."""
        k, n = np.cumsum(records(5, 0.05, 1_000), axis=1), np.arange(1, 1_001)
        with np.errstate(invalid="ignore"):
            false = bdtr(k, n, 0.05) < DELTA
        assert np.count_nonzero(false[:, 99:].any(axis=1)) > ALLOWED
        assert np.count_nonzero(false[:, 999]) <= ALLOWED

    def test_clopper_pearson_on_both_sides_for_a_fixed_number(self) -> None:
        for p in (0.001, 0.05, 0.5, 0.99):
            counts, times = np.unique(records(6, p, 299).sum(axis=1), return_counts=True)
            upper = [clopper_pearson_upper(int(k), 299, DELTA) < p for k in counts]
            lower = [clopper_pearson_lower(int(k), 299, DELTA) > p for k in counts]
            assert max(int(times[upper].sum()), int(times[lower].sum())) <= ALLOWED

    def test_power(self) -> None:
        """The classes after 1,000 samples with P = .02: on average at most .015 above and .0105 below."""
        uppers, lowers = [], []
        for row in records(7, 0.02, 1_000, 50):
            bounds = FailureSequence(delta=DELTA)
            for failed in row.tolist():
                bounds.add(failed)
            uppers.append(bounds.upper())
            lowers.append(bounds.lower())
        assert 0.02 < np.mean(uppers) < 0.035
        assert 0.0095 < np.mean(lowers) < 0.02


QUANTILES: dict[str, tuple[Callable[[np.random.Generator, tuple[int, int]], Floats], float, float]] = {
    # draws, q, Q_q
    "normal": (lambda rng, size: rng.standard_normal(size), 0.1, -1.2815515655446004),
    "Cauchy": (lambda rng, size: rng.standard_cauchy(size), 0.1, -3.0776835371752527),
    "atom at the quantile": (lambda rng, size: np.where(rng.uniform(size=size) < 0.3, -1.0, 2.0), 0.1, -1.0),
    "jump at the quantile": (lambda rng, size: np.where(rng.uniform(size=size) < 0.1, -9.0, 2.0), 0.1, -9.0),
    "median of two points": (lambda rng, size: np.where(rng.uniform(size=size) < 0.5, -1.0, 1.0), 0.5, -1.0),
}
GRID = np.linspace(-10, 5, 301)


@pytest.mark.parametrize("law", QUANTILES)
class TestQuantile:
    def test_false_claims_of_a_thousand_campaigns(self, law: str) -> None:
        """False at some n if and only if the least t above Q_q is rejected; with the tightest grid, just above Q_q."""
        draw, q, truth = QUANTILES[law]
        values = draw(np.random.default_rng(8), (RUNS, 800))
        for t in (np.nextafter(truth, np.inf), GRID[truth < GRID][0]):
            assert ever(mixture_wealth(values < t, q)) <= ALLOWED

    def test_fixed_numbers_and_the_class(self, law: str) -> None:
        draw, q, truth = QUANTILES[law]
        values = draw(np.random.default_rng(9), (RUNS, 300))
        rank = quantile_rank(300, q, DELTA)
        assert rank is not None
        assert np.count_nonzero(np.sort(values, axis=1)[:, rank - 1] > truth) <= ALLOWED
        false = 0
        for row in values[:100]:
            bound = QuantileSequence(q, GRID.tolist(), delta=DELTA)
            for value in row.tolist():
                bound.add(value)
            false += (bound.lower() or -np.inf) > truth
        assert false <= binom.ppf(0.99, 100, DELTA)

    def test_power(self, law: str) -> None:
        """After 1,600 values, against what the values of a thousand times as many say of a quantile at .7 q."""
        draw, q, _ = QUANTILES[law]
        rng, found = np.random.default_rng(10), []
        easy = np.quantile(draw(rng, (1, 1_600_000)), 0.7 * q)
        for row in draw(rng, (10, 1_600)):
            bound = QuantileSequence(q, GRID.tolist(), delta=DELTA)
            for value in row.tolist():
                bound.add(value)
            found.append(bound.lower() or -np.inf)
        assert np.median(found) >= easy - (GRID[1] - GRID[0])


def test_next_rollout_is_missed_as_often_as_stated() -> None:
    """Exactly k/(n + 1) without ties; a rank that is twice too large is caught."""
    values = np.random.default_rng(11).standard_cauchy((RUNS, 100))
    past, rank = np.sort(values[:, :99], axis=1), next_rollout_rank(99, DELTA)
    assert rank is not None
    assert RUNS * DELTA / 10 < np.count_nonzero(values[:, 99] < past[:, rank - 1]) <= ALLOWED
    assert np.count_nonzero(values[:, 99] < past[:, 2 * rank - 1]) > ALLOWED


Draw = Callable[[np.random.Generator, tuple[int, ...]], Floats]


def atoms(places: list[float], chances: list[float]) -> Draw:
    return lambda rng, size: rng.choice(places, size, p=chances)


LAWS: dict[str, Draw] = {
    "uniform": lambda rng, size: rng.uniform(size=size),
    "Beta": lambda rng, size: rng.beta(5, 2, size),
    "heavy atoms": atoms([0.0, 0.3, 0.8, 0.9], [0.03, 0.1, 0.4, 0.47]),
    "an atom and a density": lambda rng, size: np.where(rng.uniform(size=size) < 0.7, 0.8, rng.uniform(0.3, 1, size)),
    "two points": atoms([0.2, 0.9], [0.5, 0.5]),
    "a jump at q": atoms([0.2, 0.9], [0.1, 0.9]),
    "rare falls": atoms([0.0, 0.9], [0.01, 0.99]),
    "nearly always 0": atoms([0.0, 1.0], [0.99, 0.01]),
}


def sample_of(law: str) -> Floats:
    """Return a large sample that stands for the law: its CVaR and risk are the truths."""
    return np.sort(LAWS[law](np.random.default_rng(12), (2_000_000,)))


def true_cvar(sample: Floats, share: float) -> float:
    return float(sample[: round(share * len(sample))].mean())


def true_risk(sample: Floats, risk_weight: float) -> float:
    return float(sample.mean() - risk_weight * sample.std())


SLACK = 2e-3
"""More than the error of the truths."""


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("runs", [100, pytest.param(RUNS, marks=pytest.mark.slow)])
class TestFalseClaims:
    """A claim is false at some n only if the candidate at the truth is rejected: counted without the others."""

    @pytest.mark.parametrize("share", [0.1, 0.5])
    def test_cvar(self, law: str, share: float, runs: int) -> None:
        wealth = cvar_wealth(
            LAWS[law](np.random.default_rng(13), (runs, 150)), share, true_cvar(sample_of(law), share) + SLACK
        )
        assert ever(np.log(wealth)) <= binom.ppf(0.99, runs, DELTA)

    @pytest.mark.parametrize("risk_weight", [0.0, 0.2, 1.0])
    def test_risk_and_mean(self, law: str, risk_weight: float, runs: int) -> None:
        values = LAWS[law](np.random.default_rng(14), (runs, 150))
        wealth = risk_wealth(values, risk_weight, true_risk(sample_of(law), risk_weight) + SLACK)
        assert ever(np.log(wealth)) <= binom.ppf(0.99, runs, DELTA)


class TestRiskMartingale:
    @pytest.mark.parametrize("risk_weight", [0.0, 0.5])
    def test_the_vectorised_rule_is_that_of_the_class(self, risk_weight: float) -> None:
        values = np.random.default_rng(15).beta(2, 1, (5, 60))
        bounds = []
        for row in values:
            # Delta enters s alone: the same as that of the vectorised rule, with a threshold that is never reached.
            bound = RiskSequence(risk_weight, (0.0, 1.0), delta=DELTA)
            bound._bets.thresholds = (math.inf,)
            for value in row.tolist():
                bound.add(value)
            bounds.append(bound)
        m = float(bounds[0]._bets.candidates[2048])
        found = risk_wealth(values, risk_weight, m)
        for bound, row in zip(bounds, found, strict=True):
            assert bound._bets.wealth[:, 2048].sum() == pytest.approx(row[-1], rel=1e-9)

    @pytest.mark.parametrize("runs", SIZES)
    @pytest.mark.parametrize(("risk_weight", "p"), [(0.0, 0.5), (0.0, 0.05), (0.5, 0.5), (0.5, 0.05)])
    def test_the_mean_wealth_is_at_most_one(self, risk_weight: float, p: float, runs: int) -> None:
        values = np.where(records(16, p, 40, runs), 0.0, 1.0)
        wealth = risk_wealth(values, risk_weight, 1 - p - risk_weight * math.sqrt(p * (1 - p)))
        assert is_at_most_one(wealth[:, -1])
        assert np.count_nonzero(wealth.max(axis=1) >= 1 / DELTA) <= binom.ppf(0.99, runs, DELTA)

    @pytest.mark.parametrize("risk_weight", [0.0, 0.5])
    def test_a_tight_case_is_false_more_often_than_a_tenth_of_delta(self, risk_weight: float) -> None:
        """Two points with p = 1/2: with time c and s approach the mean and the sd, where nothing is lost."""
        values = np.where(records(17, 0.5, 300), 0.0, 1.0)
        wealth = risk_wealth(values, risk_weight, 0.5 - risk_weight * 0.5)
        assert np.mean(wealth.max(axis=1) >= 1 / DELTA) > DELTA / 10

    def test_a_candidate_below_the_truth_is_caught(self) -> None:
        """The true risk is .25; a reading that is .07 too large, such as one without its 1/2, has the same effect."""
        values = np.where(records(19, 0.5, 100, 4_000), 0.0, 1.0)
        assert not is_at_most_one(risk_wealth(values, 0.5, 0.18)[:, -1])


NEAR = 0.01


class FixedT(CvarSequence):
    """CVaR with one t."""

    def __init__(self, share: float, t: float) -> None:
        super().__init__(share, (0.0, 1.0), delta=DELTA)
        self._bar = t

    def _renew(self) -> None:
        moments(self)


class FixedConstants(RiskSequence):
    """The linearised risk with one c and one s."""

    def __init__(self, risk_weight: float, c: float, s: float) -> None:
        super().__init__(risk_weight, (0.0, 1.0), delta=DELTA)
        self._centre, self._spread = c, s

    def _renew(self) -> None:
        moments(self)


def moments(bound: PredictableSequence) -> None:
    x = bound._read(bound._sorted)
    bound._weight, bound._mean, bound._squares = float(len(x)), float(x.mean()), float(x.var() * len(x))


def lower_of(bound: PredictableSequence, values: Floats) -> float:
    for value in values.tolist():
        bound.add(value)
    return bound.lower()


def mean_lower(make: Callable[[], PredictableSequence], campaigns: Floats) -> float:
    return float(np.mean([lower_of(make(), values) for values in campaigns]))


FAST, SLOW = ("an atom and a density", "a jump at q"), ("uniform", "Beta", "heavy atoms", "two points", "rare falls")
MANY = [pytest.param(law, 20, marks=pytest.mark.slow) for law in (*FAST, *SLOW)]


@pytest.mark.parametrize(("law", "seeds"), [*((law, 1) for law in FAST), *MANY])
class TestPower:
    """Bounds after 1,600 values are within 5 % of those with the best fixed parameters, chosen with the law known.

    Where the bound itself is near the end of the range, 5 % of it are little: a hundredth of the range is allowed.
    """

    def test_cvar(self, law: str, seeds: int) -> None:
        campaigns, sample = LAWS[law](np.random.default_rng(20), (seeds, 1_600)), sample_of(law)
        for share in (0.1, 0.25) if seeds > 1 else (0.1,):
            places = set(np.quantile(sample, np.array([0.75, 1.0, 1.25]) * share).tolist())
            best = max(mean_lower(partial(FixedT, share, t), campaigns) for t in places)
            past = mean_lower(partial(CvarSequence, share, (0.0, 1.0), delta=DELTA), campaigns)
            assert past >= best - max(0.05 * best, NEAR)

    def test_risk(self, law: str, seeds: int) -> None:
        campaigns, sample = LAWS[law](np.random.default_rng(21), (seeds, 1_600)), sample_of(law)
        centre, spread = float(sample.mean()), float(sample.std())
        factors = (0.8, 1.0, 1.4) if seeds > 1 else (1.0,)
        best = max(mean_lower(partial(FixedConstants, 0.2, centre, f * spread), campaigns) for f in factors)
        past = mean_lower(partial(RiskSequence, 0.2, (0.0, 1.0), delta=DELTA), campaigns)
        assert past >= 0.95 * best


def test_power_of_the_failure_probability_after_a_stop_at_the_first_failure() -> None:
    """A search for a counterexample that ends at the first one, after 1,000 samples: p is at most .5 %."""
    bounds = FailureSequence(delta=DELTA)
    for n in range(1_001):
        bounds.add(n == 1_000)
    assert bounds.upper() == beta_mixture_upper(0, 1_000, DELTA) < 0.005


class TestAJumpInTheBox:
    """A start is good, or with probability `share` it is in a hole; no kernel sees it, and no claim needs one."""

    @pytest.mark.parametrize("share", [0.005, 0.011, 0.02, 0.05])
    @pytest.mark.parametrize("quantity", ["failure_probability", "share_of_starts"])
    @pytest.mark.parametrize("fixed", [True, pytest.param(False, marks=pytest.mark.slow)])
    def test_claims_are_false_at_most_as_often_as_stated(
        self, share: float, quantity: SampledQuantity, fixed: bool
    ) -> None:
        count, good, bad = 299, 0.7, -0.7
        terms = Terms(quantity, DELTA, level=0.1, clip=(-1.0, 1.0), deterministic=True)

        def bound(hit: NDArray[np.bool_]) -> float:
            method = SampleMethod([terms], lambda _: (0.0,), fixed=count if fixed else None, largest=True)
            values = [Observation(0.0, (bad if each else good,)) for each in hit]
            method.recall([(method.propose(), value) for value in values])
            found = method.found(0)
            assert found is not None
            return found

        hits = records(17, share, count)
        # The exact bounds depend on the number of hits alone.
        known = {int(hit.sum()): bound(hit) for hit in hits[np.unique(hits.sum(axis=1), return_index=True)[1]]}
        bounds = [known[int(hit.sum())] if fixed else bound(hit) for hit in hits]
        # All starts but a tenth are good: at most .7 is right.
        false = sum(each < share if quantity == "failure_probability" else each > good for each in bounds)
        assert false <= ALLOWED
        # Power: a claim that is never false because it claims nothing would pass as well.
        power = np.median(bounds)
        assert power < 1.6 * share + 0.016 if quantity == "failure_probability" else power > good - 0.01
