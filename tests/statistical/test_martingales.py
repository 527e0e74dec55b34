"""Spot check, CVaR and one law: mean wealth at most 1, false claims at most as often as stated, mistakes caught.

The vectorised rules are compared with the classes first. The slow tests have the full sizes.
"""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from perfbound.orchestrator.mathematics.bounds.checks.spot_check import Hypothesis, SpotTests
from perfbound.orchestrator.mathematics.bounds.checks.stationarity import LEVEL, AdaptiveOrderTest, PlannedOrderTest
from perfbound.orchestrator.mathematics.bounds.one_law.predictable import CvarSequence, sample_quantile
from tests.statistical.vectorised import SpotChecks, cvar_wealth

Floats = NDArray[np.float64]
DELTA = 0.05
SIZES = [10_000, pytest.param(100_000, marks=pytest.mark.slow)]


def is_at_most_one(wealth: Floats) -> bool:
    """Return whether the mean of the wealth of many runs is at most 1 + 3 standard errors."""
    return bool(wealth.mean() <= 1 + 3 * wealth.std() / math.sqrt(len(wealth)))


def allowed(count: int, delta: float) -> int:
    return int(binom.ppf(0.99, count, delta))


# Spot check


def two_points(rng: np.random.Generator, runs: int, p: float) -> Floats:
    """Return excesses of mean 0: 1 - p with probability p, else -p."""
    return np.where(rng.uniform(size=runs) < p, 1 - p, -p)


def spot_checks(runs: int, size: int, tests: int, p: float, seed: int, **wrong: Any) -> SpotChecks:
    """Run spot checks whose claim is just true; with a mistake, without an end by futility."""
    rng, checks = np.random.default_rng(seed), SpotChecks(runs, size, -p, 1 - p)
    for _ in range(tests):
        node, active = checks.choose(DELTA)
        checks.add(node, two_points(rng, runs, p), active | bool(wrong), **wrong)
    return checks


class TestSpotCheck:
    def test_the_vectorised_rule_is_that_of_the_class(self) -> None:
        rng = np.random.default_rng(1)
        excess = np.clip(0.05 + 0.2 * rng.standard_normal((10, 40)), -0.5, 1.0)
        checks = SpotChecks(10, 4, -0.5, 1.0)
        for column in excess.T:
            node, active = checks.choose(DELTA)
            checks.add(node, column, active)
        for run, values in enumerate(excess):
            check = SpotTests(
                [(float(j),) for j in range(4)], [Hypothesis("J", 0.0, -0.5, 1.0, noisy=True)], followups=99
            )
            for value in values:
                if (proposal := check.propose()) is not None:
                    check.observe(proposal.node, [value])
            finding = check.finding(0)
            assert finding.wealth == pytest.approx(checks.peak[run], rel=1e-9)
            assert finding.rollouts == checks.count[run].sum()

    @pytest.mark.parametrize("runs", SIZES)
    @pytest.mark.parametrize(("size", "p"), [(1, 0.5), (5, 0.1), (5, 0.5), (5, 0.9)])
    def test_the_mean_wealth_is_at_most_one(self, size: int, p: float, runs: int) -> None:
        checks = spot_checks(runs, size, 30, p, 2)
        assert is_at_most_one(checks.mean_wealth())
        assert np.count_nonzero(checks.peak >= 1 / DELTA) <= allowed(runs, DELTA)

    def test_a_tight_case_is_false_more_often_than_a_tenth_of_delta(self) -> None:
        checks = spot_checks(5_000, 1, 200, 0.5, 3)
        assert np.mean(checks.peak >= 1 / DELTA) > DELTA / 10

    def test_a_wrong_factor_is_caught(self) -> None:
        assert not is_at_most_one(spot_checks(20_000, 1, 5, 0.5, 4, factor=1.02).mean_wealth())

    def test_followups_that_are_left_out_for_their_value_are_caught(self) -> None:
        assert not is_at_most_one(spot_checks(20_000, 5, 10, 0.5, 4, late=True).mean_wealth())

    def test_a_start_named_without_the_number_of_starts_is_caught(self) -> None:
        """Twenty starts, each of which may be named at 1/delta instead of 2m/delta."""
        checks = spot_checks(2_000, 20, 60, 0.5, 5)
        assert np.count_nonzero(checks.own_peak.max(axis=1) >= 2 * 20 / DELTA) <= allowed(2_000, DELTA)
        assert np.count_nonzero(checks.own_peak.max(axis=1) >= 1 / DELTA) > allowed(2_000, DELTA)


# All but a share


def at_the_bar(rng: np.random.Generator, runs: int, n: int, share: float) -> Floats:
    """Return values of a law with CVaR_share = 1/4 and E[x] = 1/4 for every t from 1/4 to 1: nothing is lost."""
    return np.where(rng.uniform(size=(runs, n)) < share, 0.25, 1.0)


def a_law(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return means of three kinds of starts in [0, 1] and their probabilities; rollouts are 0 or 1 about them."""
    return np.sort(rng.beta(2, 1, 3)), rng.dirichlet((0.5, 1, 2))


def is_false(means: Floats, weights: Floats, bound: float, share: float) -> bool:
    """Return whether more than a share of the starts has a mean below the bound."""
    return bool(weights[means < bound].sum() > share)


class TestAllButShare:
    def test_the_vectorised_rule_is_that_of_the_class(self) -> None:
        rng = np.random.default_rng(1)
        values = rng.uniform(0, 1, (5, 60))
        found = cvar_wealth(values, 0.2, 0.125)
        for run, row in enumerate(values):
            bound = CvarSequence(0.2, (0.0, 1.0), delta=1e-299, choice=sample_quantile)
            for value in row:
                bound.add(float(value))
            assert bound._bets.wealth[:, 512].sum() == pytest.approx(found[run, -1], rel=1e-9)

    @pytest.mark.parametrize("runs", SIZES)
    @pytest.mark.parametrize("share", [0.1, 0.5])
    def test_the_mean_wealth_is_at_most_one(self, share: float, runs: int) -> None:
        wealth = cvar_wealth(at_the_bar(np.random.default_rng(2), runs, 40, share), share, 0.25)
        assert is_at_most_one(wealth[:, -1])
        assert np.count_nonzero(wealth.max(axis=1) >= 1 / DELTA) <= allowed(runs, DELTA)

    def test_a_tight_case_is_false_more_often_than_a_tenth_of_delta(self) -> None:
        wealth = cvar_wealth(at_the_bar(np.random.default_rng(3), 1_000, 200, 0.5), 0.5, 0.25)
        assert np.mean(wealth.max(axis=1) >= 1 / DELTA) > DELTA / 10

    def test_a_bound_of_too_large_a_candidate_is_caught(self) -> None:
        """The candidate .22 is below the true .25: to call it a null is a mistake of .03."""
        wealth = cvar_wealth(at_the_bar(np.random.default_rng(4), 20_000, 40, 0.5), 0.5, 0.22)
        assert not is_at_most_one(wealth[:, -1])

    @pytest.mark.parametrize(("laws", "n"), [(60, 120), pytest.param(2_000, 400, marks=pytest.mark.slow)])
    def test_all_but_a_tenth_of_laws_with_known_truth(self, laws: int, n: int) -> None:
        rng, false = np.random.default_rng(5), 0
        for _ in range(laws):
            means, weights = a_law(rng)
            bound = CvarSequence(0.1, (0.0, 1.0), delta=DELTA)
            for value in rng.binomial(4, rng.choice(means, n, p=weights)) / 4:
                bound.add(float(value))
            false += is_false(means, weights, bound.lower(), 0.1)
        assert false <= allowed(laws, DELTA)


# One law per start


def chased(rng: np.random.Generator, test: AdaptiveOrderTest | PlannedOrderTest, starts: int, tests: int) -> None:
    """Return to a start as long as its last value was low: the rule that misleads a test of later against earlier."""
    node = 0
    for n in range(tests):
        value = float(rng.standard_normal())
        if isinstance(test, AdaptiveOrderTest):
            test.observe(node, n, value)
        else:
            test.observe(value)
        node = node if value < 0 else (node + 1) % starts


def false_alarms(campaigns: int, starts: int | None, tests: int) -> int:
    rng, found = np.random.default_rng(6), 0
    for _ in range(campaigns):
        test = AdaptiveOrderTest(starts=starts)
        chased(rng, test, 5, tests)
        found += test.finding().status == "refuted"
    return found


class TestOneLaw:
    @pytest.mark.parametrize("campaigns", [200, pytest.param(10_000, marks=pytest.mark.slow)])
    @pytest.mark.parametrize("starts", [5, None])
    def test_false_alarms_of_chosen_tests(self, starts: int | None, campaigns: int) -> None:
        assert false_alarms(campaigns, starts, 100) <= allowed(campaigns, LEVEL)

    @pytest.mark.parametrize("campaigns", [200, pytest.param(10_000, marks=pytest.mark.slow)])
    def test_false_alarms_of_planned_tests(self, campaigns: int) -> None:
        """Opening and closing round, with ties: a fifth of the values is at the end of the clip."""
        rng, found = np.random.default_rng(7), 0
        plan = [(n % 10, float(n >= 40)) for n in range(80)]
        for _ in range(campaigns):
            test = PlannedOrderTest(plan)
            for value in np.minimum(rng.standard_normal(80), 0.8):
                test.observe(float(value))
            found += test.finding().status == "refuted"
        assert found <= allowed(campaigns, LEVEL)

    def test_the_mean_wealth_is_one_and_a_tight_case_is_tight(self) -> None:
        """One column, its ranks drawn directly: they are independent and uniform."""
        rng, runs = np.random.default_rng(8), 20_000
        wealth, peak = np.full((8, runs), 1 / 8), np.ones(runs)
        for n in range(1, 401):
            bets = [slope * min(1.0, n / ramp) for slope in (0.15, 0.5) for ramp in (50, 400)]
            place = (rng.integers(n, size=runs) + 0.5) / n
            wealth *= 1 + np.outer([*bets, *(-b for b in bets)], 2 * place - 1)
            peak = np.maximum(peak, wealth.sum(axis=0))
        assert is_at_most_one(wealth.sum(axis=0))
        assert LEVEL / 10 < np.mean(peak >= 1 / LEVEL) <= allowed(runs, LEVEL) / runs

    def test_a_product_over_starts_that_values_chose_is_caught(self) -> None:
        """A start that is visited again only after a low value: the second value is higher, without any drift."""
        rng, found = np.random.default_rng(9), 0
        for _ in range(100):
            first = rng.standard_normal(100)
            returned = np.flatnonzero(first < -0.5)
            plan = [(int(j), 0.0) for j in returned] + [(int(j), 1.0) for j in returned]
            test = PlannedOrderTest(plan)
            for value in [*first[returned], *rng.standard_normal(len(returned))]:
                test.observe(float(value))
            found += test.finding().status == "refuted"
        assert found > allowed(100, LEVEL)
