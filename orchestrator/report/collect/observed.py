"""The observed tests of a problem as columns, of very many tests a choice; values have the sign of the objective."""

import numpy as np
from numpy.typing import NDArray

from ...campaign.plan import ProblemPlan
from ...forecast import remaining
from ...store.facts import ObservedTest
from ..data.page import TestSeries
from .recorded_tests import Floats, ObservedTests

MOST_TESTS = 5000
"""Tests in the columns; of more the worst half, and an even choice of the others."""


def observed_series(plan: ProblemPlan, tests: ObservedTests) -> TestSeries:
    """Return the columns of the observed tests, in their order."""
    chosen, sense = _choice(plan, tests), plan.sense
    kept, badness = [tests[test] for test in chosen.tolist()], _badness(plan, tests)[chosen].tolist()
    upper = tuple(signed(each.bound.upper, sense) for each in kept)
    lower = tuple(signed(each.bound.lower, sense) for each in kept)
    observed_sense = "min" if plan.candidates is None else sense
    return TestSeries(
        test=tuple(each.test for each in kept),
        x=tuple(each.proposal.x for each in kept),
        y=tuple(signed(value, observed_sense) for value in badness),
        distance=tuple(_distance(plan, each) for each in kept),
        lower=upper if sense == "min" else lower,
        upper=lower if sense == "min" else upper,
    )


def worst_first(plan: ProblemPlan, tests: ObservedTests) -> NDArray[np.intp]:
    """Return the numbers of the tests from the worst observed one to the best, equal ones in their order."""
    return np.argsort(-_badness(plan, tests), kind="stable")


def signed(value: float | None, sense: str) -> float | None:
    """Return a value of J with the sign of the objective.

    >>> signed(0.25, "min"), signed(0.25, "max"), signed(0.0, "min")
    (-0.25, 0.25, 0.0)
    """
    # 0.0 - value: -0.0 would be printed as a negative number
    return value if value is None or sense == "max" else 0.0 - value


def _distance(plan: ProblemPlan, test: ObservedTest) -> float | None:
    # Of several requirements each has its own.
    return None if plan.parts else remaining.distance(plan.problem, test.proposal.F, test.bound)


def _choice(plan: ProblemPlan, tests: ObservedTests) -> NDArray[np.intp]:
    """Return the numbers of the tests in the columns, in their order."""
    number = len(tests)
    if number <= MOST_TESTS:
        return np.arange(number)
    half, kept = MOST_TESTS // 2, np.zeros(number, dtype=np.bool_)
    kept[worst_first(plan, tests)[:half]] = True
    others = np.flatnonzero(~kept)
    kept[others[np.rint(np.linspace(0, len(others) - 1, half - 2)).astype(np.intp)]] = True
    # The bounds begin with the first test and end with the last.
    kept[[0, -1]] = True
    return np.flatnonzero(kept)


def _badness(plan: ProblemPlan, tests: ObservedTests) -> Floats:
    """Return J of each test (n,), which is maximised; where starts are drawn the worst robustness, whatever it is."""
    if plan.candidates is not None or not len(tests):
        return tests.y
    worst: Floats = -np.nanmin(tests.each[:, : plan.replicates], axis=1)
    return worst
