"""The observed tests of a problem as columns, of very many tests a choice; values have the sign of the objective."""

from collections.abc import Sequence

import numpy as np

from ....schemas.values import Observation
from ...campaign.plan import ProblemPlan
from ...forecast import remaining
from ...store.facts import ObservedTest
from ..data.page import TestSeries

MOST_TESTS = 5000
"""Tests in the columns; of more the worst half, and an even choice of the others."""


def observed_series(plan: ProblemPlan, tests: Sequence[ObservedTest]) -> TestSeries:
    """Return the columns of the observed tests, in their order."""
    kept, sense = _choice(plan, tests), plan.sense
    upper = tuple(signed(each.bound.upper, sense) for each in kept)
    lower = tuple(signed(each.bound.lower, sense) for each in kept)
    observed_sense = "min" if plan.candidates is None else sense
    return TestSeries(
        test=tuple(each.test for each in kept),
        x=tuple(each.proposal.x for each in kept),
        y=tuple(signed(_badness(plan, each.observation), observed_sense) for each in kept),
        distance=tuple(_distance(plan, each) for each in kept),
        lower=upper if sense == "min" else lower,
        upper=lower if sense == "min" else upper,
    )


def worst_first(plan: ProblemPlan, tests: Sequence[ObservedTest]) -> list[ObservedTest]:
    """Return the tests from the worst observed one to the best, equal ones in their order."""
    return sorted(tests, key=lambda each: (-_badness(plan, each.observation), each.test))


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


def _choice(plan: ProblemPlan, tests: Sequence[ObservedTest]) -> Sequence[ObservedTest]:
    if len(tests) <= MOST_TESTS:
        return tests
    half = MOST_TESTS // 2
    kept = {each.test for each in worst_first(plan, tests)[:half]}
    others = [each for each in tests if each.test not in kept]
    even = np.rint(np.linspace(0, len(others) - 1, half - 2)).astype(np.intp).tolist()
    # The bounds begin with the first test and end with the last.
    kept |= {others[place].test for place in even} | {tests[0].test, tests[-1].test}
    return [each for each in tests if each.test in kept]


def _badness(plan: ProblemPlan, observation: Observation) -> float:
    """Return J, which is maximised; where starts are drawn the worst robustness, whatever is bounded."""
    return -min(observation.each[: plan.replicates]) if plan.candidates is None else observation.y
