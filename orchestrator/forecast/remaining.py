"""The forecast of a problem: its remaining tests, and budgets that cannot suffice. No certificate depends on it."""

import math
from typing import TYPE_CHECKING

from ...schemas.file.config import CampaignConfig
from ...schemas.file.problem_models import KernelProblem, PaperProblem, Problem, RigorousProblem
from ...schemas.values import Bound

if TYPE_CHECKING:
    from ..campaign.plan import Plans, ProblemPlan

FEWEST = 10
"""Tests before the decay is worth a guess."""


def distance(problem: Problem, last_f: float | None, bound: Bound | None) -> float | None:
    """Return the number that has to fall to alpha: F_i in method paper, else upper - lower; None before the first."""
    if isinstance(problem, PaperProblem):
        return last_f
    if problem.alpha is None:
        return None  # its number of tests is fixed
    return None if bound is None or bound.upper is None or bound.lower is None else bound.upper - bound.lower


def budget(config: CampaignConfig, problem: Problem, extended: int | None) -> int:
    """Return the tests at most of a problem; `extended` is the budget that an extension gave it."""
    return config.max_tests_of(problem) if extended is None else extended


def tests_left(
    config: CampaignConfig, problem: Problem, now: float | None, tests: int, extended: int | None
) -> int | None:
    """Guess the tests until the distance is alpha or the budget ends; None where the decay allows no guess yet.

    The distance falls roughly like a power of the number of tests; the power is taken from the start until now.
    """
    left = budget(config, problem, extended) - tests
    if problem.alpha is None:
        return left
    start = _start(config, problem)
    if now is None or tests < FEWEST or not 0 < now < start:
        return None
    power = math.log(start / now) / math.log(tests)
    exponent = math.log(max(1.0, now / problem.alpha)) / power
    needed = math.inf if exponent > 50 else tests * math.exp(exponent)
    return max(0, min(math.ceil(min(needed, 1e12)) - tests, left))


def warnings(plans: "Plans") -> list[str]:
    """Return a line for every problem whose budget cannot reach its tolerance."""
    return [line for plan in plans.values() for part in plan.parts or (plan,) if (line := out_of_reach(part))]


def out_of_reach(plan: "ProblemPlan") -> str | None:
    """Return a sentence if the budget of a `rigorous` problem cannot reach alpha, however the tests are placed."""
    problem, tests, least = plan.problem, plan.budget, least_distance(plan)
    if problem.alpha is None or least <= problem.alpha:
        return None
    return (
        f"{plan.key}: {tests:,} tests cannot be expected to reach alpha = {problem.alpha:g}: even with all tests "
        f"at one point, upper and lower bound stay about {least:.3g} apart. The budget ends the problem then; raise "
        "max_tests or alpha, or continue with the wider bound"
    )


def least_distance(plan: "ProblemPlan") -> float:
    """Return the least distance of upper and lower bound that a budget can reach, in the unit of the objective.

    n observations of one and the same z leave upper - lower >= 2 R sqrt(2 ln(1/delta)/n) in [FR]; elsewhere it is more.
    """
    problem = plan.problem
    if not isinstance(problem, RigorousProblem) or plan.noise == 0:
        return 0.0
    least = 2 * plan.noise * math.sqrt(2 * math.log(1 / problem.delta) / plan.budget)
    # Without any test |J - m0| <= B + tau: upper and lower are never further apart than this.
    return min(least, 2 * (problem.rkhs_norm + problem.misspecification))


def _start(config: CampaignConfig, problem: Problem) -> float:
    """Return the distance before the first observation."""
    if isinstance(problem, KernelProblem):
        return 2 * problem.rkhs_norm
    return config.clip[1] - config.clip[0] if config.clip else math.inf
