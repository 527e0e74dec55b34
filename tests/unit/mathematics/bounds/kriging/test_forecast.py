"""Forecasts of method `kriging`: what is known when nothing is left, and how near they come to campaigns."""

import math

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.schemas.values import Observation

LATTICE = Lattice((0.0,), (1.0,), 21)
SD, TESTS, REPLICATES = 0.1, 60, 8


def a_method(tests: int = TESTS) -> KrigingMethod:
    premises = KrigingPremises(0.5, -0.6, (-1.2, 0.0), 0.05)
    return KrigingMethod(LATTICE, Matern(2.5, 1.0), premises, spread=SD, budget=KrigingBudget(tests, REPLICATES, 5))


def mean(x: float) -> float:
    return -0.65 + 0.1 * math.sin(3 * x)


def rollouts(rng: np.random.Generator, x: float) -> list[float]:
    """Return J of the rollouts of a test, in the range and with a skewed noise of standard deviation SD."""
    values = mean(x) + SD * np.array([2.0, -0.5])[(rng.random(REPLICATES) < 0.8).astype(int)]
    return [float(each) for each in np.clip(values, -1.2, 0.0)]


def run(method: KrigingMethod, rng: np.random.Generator, tests: int) -> float:
    """Return the upper bound of max J after so many further tests."""
    upper = 0.0
    for _ in range(tests):
        proposal = method.propose()
        each = rollouts(rng, proposal.x[0])
        bound = method.observe(proposal, Observation(float(np.mean(each)), tuple(each)))
        assert bound.upper is not None
        upper = bound.upper
    return upper


def test_nothing_is_forecast_before_every_point_was_tested() -> None:
    method, rng = a_method(), np.random.default_rng(0)
    run(method, rng, 4)
    assert method.outlook(1000) is None
    run(method, rng, 1)
    assert method.outlook(1000) is not None


def test_the_forecast_at_the_end_is_the_bound() -> None:
    method = a_method()
    upper = run(method, np.random.default_rng(0), TESTS)
    found = method.outlook(1000)
    assert found is not None
    assert np.all(found[0] == upper)
    assert np.all(method.coming.left == 0)


def test_a_forecast_after_a_third_of_the_tests_comes_near_the_end_and_changes_nothing() -> None:
    held, falls, errors = 0, list[float](), list[float]()
    for seed in range(10):
        method, rng = a_method(), np.random.default_rng(seed)
        now = run(method, rng, TESTS // 3)
        found = method.outlook(1000)
        assert found is not None
        low, middle, high = np.quantile(found[0], (0.025, 0.5, 0.975)).tolist()
        end = run(method, rng, TESTS - TESTS // 3)
        held += low <= end <= high
        falls.append(now - end)
        errors.append(abs(middle - end))
        untouched, again = a_method(), np.random.default_rng(seed)
        assert run(untouched, again, TESTS) == end
    assert np.mean(errors) < np.mean(falls), "nearer to the end than the bound so far"
    assert held >= 6, "the quantile .001 of a binomial law with 10 campaigns and a share of .9"


def test_what_more_rollouts_gain_is_about_what_a_longer_plan_gains() -> None:
    laws = [mean(x) + np.array([-SD, SD]) for x in (0.0, 0.25, 0.5, 0.75, 1.0)]
    none = np.zeros((1, 5))
    short, long = (a_method(tests).coming.forecast(laws, none)[0] for tests in (TESTS, 3 * TESTS))
    method = a_method()
    run(method, np.random.default_rng(0), TESTS)
    found = method.outlook(2.0 * TESTS * REPLICATES)
    assert found is not None
    assert np.median(found[1]) == pytest.approx(short - long, rel=0.4)
