"""The forecast of a problem with a tolerance: its own method on the fitted function, until the tolerance."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....schemas.file.config import CampaignConfig
from ....schemas.values import Bound, Guess, Observation
from ...campaign.methods import kernel_method
from ...campaign.plan import ProblemPlan
from ...forecast.remaining import tests_left
from ...mathematics.bounds.rigorous.method import ExhaustedError, RigorousMethod
from ...mathematics.calibration.kernel_fit import KernelFit
from ...mathematics.gp.kernels import Floats
from ..rounded import rounded_up
from ..size import growing_time
from .budget import rollout_time
from .constants import Constant, ProblemEvidence

MOST_WORK = 300_000
"""Tests times candidates that are tried; from there on the decay is continued."""
MOST_TESTS = 150
MARGIN = 1.5
"""The budget over the forecast: the objective is rougher than what is fitted to it."""
LARGEST_BUDGET = 2000
ERRORS = 2
"""Standard errors of the fit that a forecast allows for, on each side."""
NEAR = 0.95
"""Part of alpha that the candidates may leave: the box between them needs the rest."""


@dataclass(frozen=True, slots=True)
class ToleranceForecast:
    """The tests until the bounds are as near as `alpha`, if every assumption holds."""

    tests: int | None
    """None where the decay is too slow for a guess, or more than the largest budget."""
    widths: tuple[float, ...]
    """Upper minus lower bound after each test that was tried."""
    budget: int
    """Tests at most that are proposed."""
    seconds: float
    """Of the rollouts of this budget, with its closing checks, at the pace of the pilot, and of its own tests."""
    rollouts: int
    alpha: float
    """The tolerance: that of the plan, or if it may be raised, one that is within reach."""
    bound: Guess
    """Of J, at the end of the budget; its worse end has all of alpha on the side of the claim."""
    fitted: float
    """The largest J of the fitted function."""
    error: float
    """Standard error of this."""

    def remedy(self, limit: float) -> str:  # noqa: ARG002  (one tolerance is forecast)
        """Return what would bring the bound of J nearer to a limit."""
        return "a smaller alpha, or where that is out of reach more replicates, would come nearer"

    def settled(self, constants: tuple[Constant, ...]) -> tuple[Constant, ...]:
        """Return the constants of the problem with the budget, and with the alpha that it reaches."""
        reason = (
            f"What {len(self.widths):,} tests leave between the bounds, by the forecast; a smaller one takes more than "
            f"{LARGEST_BUDGET} tests."
        )
        raised = (
            replace(each, value=self.alpha, reason=reason) if each.key == "alpha" and each.value != self.alpha else each
            for each in constants
        )
        return (*raised, self._budget_constant())

    def _budget_constant(self) -> Constant:
        if self.tests is None:
            reason = (
                f"The forecast does not reach alpha in {LARGEST_BUDGET} tests; the bound is valid whenever they end."
            )
            return Constant("max_tests", self.budget, reason)
        reason = f"The forecast reaches alpha after about {self.tests:,} tests, if every assumption holds."
        return Constant("max_tests", self.budget, reason, f"factor {MARGIN:g}")

    @property
    def numbers(self) -> dict[str, Any]:
        """The forecast as JSON."""
        found = {"tests": self.tests, "budget": self.budget, "seconds": self.seconds, "rollouts": self.rollouts}
        return found | {"widths": list(self.widths)}


def tolerance_forecast(
    config: CampaignConfig, plan: ProblemPlan, fit: KernelFit, measured: ProblemEvidence, given: Mapping[str, Any]
) -> ToleranceForecast:
    """Return the forecast for a plan with all constants; the fitted mean serves as the objective, with its noise.

    `given` are the keys of the draft: if no user has chosen alpha, one that a campaign does not reach is no use.
    """
    data, box, started = measured.data, measured.box, time.monotonic()
    method = kernel_method(plan)
    assert isinstance(method, RigorousMethod), "the table of forecasts has others for other methods"
    nodes = (plan.chosen_from.nodes - box.low) / box.widths
    truth = fit.mean(data, nodes)
    widths, upper = _tried(method, plan, truth)
    tests, alpha = _tests(config, plan, widths), plan.problem.alpha or 0.0
    if tests is None and "alpha" not in given:
        tests, alpha = len(widths), rounded_up(widths[-1] / NEAR)
    budget = LARGEST_BUDGET if tests is None else min(math.ceil(MARGIN * tests), LARGEST_BUDGET)
    budget = int(float(f"{max(budget, 20):.2g}"))
    rollouts, seconds = rollout_time(config, plan, measured.pace, tests=budget)
    # Its own tests took as long as those of the campaign will.
    own = growing_time(time.monotonic() - started, len(widths), max(budget, len(widths))).middle
    # What is beyond the maximum falls as the distance of the bounds does.
    largest, error = float(truth.max()), fit.error(data, nodes[truth.argmax()])
    bound = largest + max(upper - largest, 0.0) * min(1.0, alpha / widths[-1]) if tests is not None else upper
    # All that alpha leaves between the bounds may be on the side of the claim.
    worst = max(bound, largest + (alpha if tests is not None else 0.0))
    guess = Guess(bound, bound - ERRORS * error, worst + ERRORS * error)
    return ToleranceForecast(tests, tuple(widths), budget, seconds + own, rollouts, alpha, guess, largest, error)


def _tried(method: RigorousMethod, plan: ProblemPlan, truth: Floats) -> tuple[list[float], float]:
    """Return upper minus lower bound after each test that is tried, and the last upper bound."""
    rng, widths = np.random.default_rng(0), list[float]()
    most = max(10, min(MOST_TESTS, MOST_WORK // method.size, plan.budget))
    first: int | None = int(rng.integers(method.size))
    upper = math.inf
    while len(widths) < most and not (widths and widths[-1] <= NEAR * (plan.problem.alpha or 0.0)):
        try:
            proposal = method.propose(first)
        except ExhaustedError:
            break
        first, y = None, float(truth[proposal.node] + plan.noise * rng.standard_normal())
        method.recall([(proposal, Observation(y, (y,)))])
        band = method.band(Bound(None, -math.inf, None))
        upper = max(band.upper)
        widths.append(upper - max(band.lower))
    return widths, upper


def _tests(config: CampaignConfig, plan: ProblemPlan, widths: list[float]) -> int | None:
    done, alpha = len(widths), plan.problem.alpha or 0.0
    if widths[-1] <= NEAR * alpha or done == plan.chosen_from.size:
        return done
    left = tests_left(config, plan.problem, widths[-1], done, 10**6)
    return None if left is None or done + left > LARGEST_BUDGET else done + left
