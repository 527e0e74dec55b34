"""The forecast of a calibrated problem: its own method on the fitted function, until its tolerance."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ...schemas.campaign import CampaignConfig
from ...schemas.values import Bound, Observation
from ..mathematics.bounds.rigorous import ExhaustedError, RigorousMethod
from ..mathematics.calibration.kernel_fit import KernelFit
from ..mathematics.calibration.sampled import SampledValues, kernel_matrix
from ..mathematics.gp.kernels import Floats
from .calibration import Constant, ProblemEvidence
from .first_size import LEAST_COST, PER_SECOND, WORKERS
from .forecast import tests_left
from .methods import kernel_method
from .pilot import rounded_up
from .plan import ProblemPlan

MOST_WORK = 300_000
"""Tests times candidates that are tried; from there on the decay is continued."""
MOST_TESTS = 150
MARGIN = 1.5
"""The budget over the forecast: the objective is rougher than what is fitted to it."""
LARGEST_BUDGET = 2000
NEAR = 0.95
"""Part of alpha that the candidates may leave: the box between them needs the rest."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """The tests until the bounds are as near as `alpha`, if every assumption holds."""

    tests: int | None
    """None where the decay is too slow for a guess, or more than the largest budget."""
    widths: tuple[float, ...]
    """Upper minus lower bound after each test that was tried."""
    budget: int
    """Tests at most that are proposed."""
    seconds: float
    """Of the rollouts of this budget, with its closing checks, for `workers`."""
    rollouts: int
    alpha: float
    """The tolerance: that of the plan, or if it may be raised, one that is within reach."""
    workers: int = WORKERS


def forecast(
    config: CampaignConfig, plan: ProblemPlan, fit: KernelFit, measured: ProblemEvidence, *, may_raise: bool
) -> Forecast:
    """Return the forecast for a plan with all constants; the fitted mean serves as the objective, with its noise.

    `may_raise`: no user has chosen alpha, and one that a campaign does not reach is no use.
    """
    data, box, cost = measured.data, measured.box, measured.cost
    method = kernel_method(plan)
    assert isinstance(method, RigorousMethod), "other methods are not calibrated"
    widths = _widths(method, plan, _fitted(fit, data, (plan.chosen_from.nodes - box.low) / box.widths))
    tests, alpha = _tests(config, plan, widths), plan.problem.alpha or 0.0
    if tests is None and may_raise:
        tests, alpha = len(widths), rounded_up(widths[-1] / NEAR)
    budget = LARGEST_BUDGET if tests is None else min(math.ceil(MARGIN * tests), LARGEST_BUDGET)
    budget = int(float(f"{max(budget, 20):.2g}"))
    closing = (config.spot_check + config.recheck) * len(plan.variants)
    rollouts = budget * len(plan.rollouts) + closing
    rate = min(PER_SECOND, WORKERS / max(cost, LEAST_COST))
    return Forecast(tests, tuple(widths), budget, rollouts / rate, rollouts, alpha)


def with_forecast(constants: tuple[Constant, ...], found: Forecast) -> tuple[Constant, ...]:
    """Return the constants of a problem with the budget, and with the alpha that it reaches."""
    reason = (
        f"What {len(found.widths)} tests leave between the bounds, by the forecast; a smaller one takes more than "
        f"{LARGEST_BUDGET} tests."
    )
    raised = (
        replace(each, value=found.alpha, reason=reason) if each.key == "alpha" and each.value != found.alpha else each
        for each in constants
    )
    return (*raised, budget_constant(found))


def budget_constant(found: Forecast) -> Constant:
    """Return the budget of a problem as a constant of the file."""
    if found.tests is None:
        reason = f"The forecast does not reach alpha in {LARGEST_BUDGET} tests; the bound is valid whenever they end."
        return Constant("max_tests", found.budget, reason)
    reason = f"The forecast reaches alpha after about {found.tests} tests, if every assumption holds."
    return Constant("max_tests", found.budget, reason, f"factor {MARGIN:g}")


def _fitted(fit: KernelFit, data: SampledValues, shares: Floats) -> Floats:
    """Return the posterior mean at starts (m, p), in the unit of J."""
    centre = float(data.values.mean())
    return np.asarray(centre + kernel_matrix(fit.nu, fit.lengths, shares, data.shares) @ fit.weights(data, centre))


def _widths(method: RigorousMethod, plan: ProblemPlan, truth: Floats) -> list[float]:
    rng, widths = np.random.default_rng(0), list[float]()
    most = max(10, min(MOST_TESTS, MOST_WORK // method.size, plan.budget))
    first: int | None = int(rng.integers(method.size))
    while len(widths) < most and not (widths and widths[-1] <= NEAR * (plan.problem.alpha or 0.0)):
        try:
            proposal = method.propose(first)
        except ExhaustedError:
            break
        first, y = None, float(truth[proposal.node] + plan.noise * rng.standard_normal())
        method.recall([(proposal, Observation(y, (y,)))])
        band = method.band(Bound(None, -math.inf, None))
        widths.append(max(band.upper) - max(band.lower))
    return widths


def _tests(config: CampaignConfig, plan: ProblemPlan, widths: list[float]) -> int | None:
    done, alpha = len(widths), plan.problem.alpha or 0.0
    if widths[-1] <= NEAR * alpha or done == plan.chosen_from.size:
        return done
    left = tests_left(config, plan.problem, widths[-1], done, 10**6)
    return None if left is None or done + left > LARGEST_BUDGET else done + left
