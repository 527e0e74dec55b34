"""The forecast of a problem whose tests are planned: the bound that several budgets may be expected to prove.

| symbol | name     | meaning                                                                   | shape  | unit   |
|--------|----------|---------------------------------------------------------------------------|--------|--------|
| x_i    |          | points of the design of a budget                                          | (q, p) | share  |
| f, C   |          | posterior mean and covariance of the objective at them                    | (q,)   | unit J |
| X_i    | `laws`   | f_i plus the residuals of the starts nearest to x_i                       | q (k,) | unit J |
| e_i    | `errors` | drawn from a normal law with covariance C + diag(var X_i/rollouts at x_i) | (r, q) | unit J |

Weights are planned for a budget, so each budget has a plan of its own.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....schemas.file.config import CampaignConfig
from ....schemas.file.problem_models import KrigingProblem
from ....schemas.values import Guess
from ...campaign.methods import kernel_method
from ...campaign.plan import ProblemPlan
from ...certificate.words.format import duration
from ...mathematics.bounds.kriging.design import most_points, points_per_parameter
from ...mathematics.bounds.kriging.method import KrigingMethod
from ...mathematics.calibration.kernel_fit import KernelFit
from ...mathematics.gp.kernels import Floats, squared_distances
from ..rounded import PARTS, rounded_up
from .constants import Constant, PilotPace, ProblemEvidence, spread_of


def rollout_time(config: CampaignConfig, plan: ProblemPlan, pace: PilotPace, *, tests: int) -> tuple[int, float]:
    """Return the rollouts of so many tests with the closing checks, and their seconds at the pace of the pilot."""
    closing = (config.spot_check + config.recheck) * len(plan.variants)
    # A test may wait for the one before it, and then a single rollout keeps the other workers idle.
    window = min(plan.window, tests)
    turns = tests / window * math.ceil(window * len(plan.rollouts) / pace.workers)
    return tests * len(plan.rollouts) + closing, (turns + math.ceil(closing / pace.workers)) * pace.cost


FEWEST, MOST = 400, 6400
"""Rollouts of the smallest and the largest budget that is proposed."""
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Of the proposed budget, those that are shown."""
FEWEST_TESTS = 50
TESTS_OF_A_POINT = 4
"""Tests at each point of a design, on average: fewer could not give corners and edges their shares."""
NEAREST = 20
"""Starts whose residuals are the noise at a point."""
DRAWS = 100
RANGE = (0.05, 0.95)
"""Of the draws, the part that a range contains."""
PLANS = 5
"""Times that the weights of a campaign are planned: at its start, and for the report and the sensitivity of its end."""
THOUSAND = 1000


@dataclass(frozen=True, slots=True)
class PlannedBudget:
    """One budget, and what it may be expected to prove."""

    tests: int
    replicates: int
    bound: Guess
    """Of J."""
    rollouts: int
    """With the closing checks."""
    seconds: float
    """Of these, at the pace of the pilot, and of the weights."""

    @property
    def enters(self) -> int:
        """Observations that enter the bound."""
        return self.tests * self.replicates


@dataclass(frozen=True, slots=True)
class BudgetForecast:
    """The bounds of several budgets, if every assumption holds."""

    budgets: tuple[PlannedBudget, ...]
    """From the smallest to the largest."""
    proposed: PlannedBudget
    doubled: PlannedBudget
    """About twice the proposed one."""
    without: float
    """The bound of J that B and the prior mean prove without any rollout."""
    fitted: float
    """The largest J of the fitted function, which no bound of J may be expected to fall below."""
    error: float
    """Standard error of this."""
    sign: int
    """1 where J is the objective, -1 where it is minus the objective."""

    @property
    def bound(self) -> Guess:
        """That of J by the proposed budget."""
        return self.proposed.bound

    @property
    def rollouts(self) -> int:
        """Those of the proposed budget, with the closing checks."""
        return self.proposed.rollouts

    @property
    def seconds(self) -> float:
        """Their duration."""
        return self.proposed.seconds

    def remedy(self, limit: float) -> str:
        """Return what would bring the bound of J nearer to a limit."""
        if self.vain:
            return "method rigorous may prove more"
        enough = next((each for each in self.budgets if each.bound.high <= limit), None)
        if enough is None:
            return f"{THOUSAND} further rollouts would bring about {self.thousand:.2g}"
        keys = f"max_tests = {enough.tests} and replicates = {enough.replicates}"
        return f"{keys} may be enough, {enough.rollouts:,} rollouts in about {duration(enough.seconds)}"

    @property
    def doubling(self) -> float:
        """By which twice the proposed budget would improve the bound."""
        return self.proposed.bound.middle - self.doubled.bound.middle

    @property
    def thousand(self) -> float:
        """By which a thousand further rollouts would, if every doubling brings as much."""
        return self.doubling * math.log2(1.0 + THOUSAND / self.proposed.enters)

    @property
    def little(self) -> float:
        """An improvement that is not worth as many rollouts again: a part of all that rollouts can bring."""
        return max(self.without - self.fitted, 0.0) / PARTS

    @property
    def vain(self) -> bool:
        """Whether the rollouts may be expected to prove next to nothing beyond the constants."""
        return self.proposed.bound.middle >= self.without - self.little

    @property
    def reason(self) -> str:
        """Why this budget is proposed."""
        more, little = f"Twice as many rollouts would improve the bound by about {self.doubling:.2g}", self.little
        if self.vain:
            return f"Even {MOST} rollouts prove next to nothing beyond the constants; method rigorous may prove more."
        if self.doubling > little:
            return f"{more}; {MOST:,} rollouts are the most that is proposed."
        return f"{more}, less than a {PARTS}th of all that rollouts can bring."

    def settled(self, constants: tuple[Constant, ...]) -> tuple[Constant, ...]:
        """Return the constants of the problem with its budget."""
        division = "All rollouts of a test have one start, and so many tests give corners and edges their shares."
        return (
            *constants,
            Constant("replicates", self.proposed.replicates, division),
            Constant("max_tests", self.proposed.tests, self.reason),
        )

    @property
    def numbers(self) -> dict[str, Any]:
        """The forecast as JSON; bounds of the objective as the certificate has it."""
        return {
            "without_rollouts": self.sign * self.without,
            "fitted": self.sign * self.fitted,
            "proposed": self.proposed.tests,
            "thousand_more": self.thousand,
            "budgets": [
                {"tests": each.tests, "replicates": each.replicates, "rollouts": each.rollouts}
                | {"bound": self.sign * each.bound.middle, "range": list(each.bound.ends(self.sign))}
                | {"seconds": each.seconds}
                for each in self.budgets
            ],
        }


def budget_forecast(
    config: CampaignConfig,
    plan: ProblemPlan,
    fit: KernelFit,
    measured: ProblemEvidence,
    given: Mapping[str, Any],  # noqa: ARG001  (no key of a draft decides a budget)
) -> BudgetForecast:
    """Return the forecast for a plan with all constants but its budget."""
    forecaster = _Forecaster(config, plan, fit, measured)
    without = forecaster.method(FEWEST).bound_after([]).upper or 0.0
    box = measured.box
    nodes = (plan.chosen_from.nodes - box.low) / box.widths
    means = fit.mean(measured.data, nodes)
    fitted = float(means.max())
    little = max(without - fitted, 0.0) / PARTS
    found = {FEWEST: forecaster.budget(FEWEST)}
    rollouts = FEWEST
    while True:
        found[2 * rollouts] = forecaster.budget(2 * rollouts)
        now, then = found[rollouts].bound.middle, found[2 * rollouts].bound.middle
        # Where the rollouts have brought nothing yet, twice as many may bring nothing either, and four times do.
        if rollouts == MOST or (now - then <= little and now < without - little):
            break
        rollouts *= 2
    shown = {size: found.get(size) or forecaster.budget(size) for size in (round(rollouts * each) for each in FACTORS)}
    return BudgetForecast(
        tuple(shown.values()),
        found[rollouts],
        found[2 * rollouts],
        without,
        fitted,
        fit.error(measured.data, nodes[means.argmax()]),
        -1 if config.sense_of(plan.problem) == "min" else 1,
    )


def expected_bound(
    config: CampaignConfig, plan: ProblemPlan, fit: KernelFit, measured: ProblemEvidence, rollouts: int
) -> Guess:
    """Return the bound of J that about so many rollouts may be expected to prove."""
    return _Forecaster(config, plan, fit, measured).budget(rollouts).bound


@dataclass(frozen=True, slots=True)
class _Forecaster:
    config: CampaignConfig
    plan: ProblemPlan
    fit: KernelFit
    measured: ProblemEvidence

    def method(self, rollouts: int) -> KrigingMethod:
        """Return the method with a plan for about so many rollouts."""
        found = kernel_method(self._planned(rollouts))
        assert isinstance(found, KrigingMethod), "the table of forecasts has others for other methods"
        return found

    def budget(self, rollouts: int) -> PlannedBudget:
        """Return what about so many rollouts may be expected to prove."""
        started, plan = time.monotonic(), self._planned(rollouts)
        bounds = self._bounds(self.method(rollouts))
        low, middle, high = np.quantile(bounds, (RANGE[0], 0.5, RANGE[1])).tolist()
        in_all, seconds = rollout_time(self.config, plan, self.measured.pace, tests=plan.budget)
        own = PLANS * (time.monotonic() - started)
        return PlannedBudget(plan.budget, plan.replicates, Guess(middle, low, high), in_all, seconds + own)

    def _planned(self, rollouts: int) -> ProblemPlan:
        tests, replicates = division(rollouts, len(self.measured.box.names))
        plan, problem = replace(self.plan, budget=tests, replicates=replicates), self.plan.problem
        if not (plan.controlled and isinstance(problem, KrigingProblem)):
            return plan
        # After its first fit the campaign plans its weights for what the control leaves.
        left = rounded_up(spread_of(self.measured, self.measured.values))
        return replace(plan, problem=problem.model_copy(update={"spread": left}))

    def _bounds(self, method: KrigingMethod) -> Floats:
        """Return bounds of J at the end of the budget, (r,)."""
        measured, box = self.measured, self.measured.box
        points = (method.lattice.nodes[list(method.design.nodes)] - box.low) / box.widths
        data = measured.data
        residuals = measured.values - self.fit.mean(data, data.shares)[:, None]
        nearest = np.argsort(squared_distances(points, data.shares), axis=1, kind="stable")[:, :NEAREST]
        means = self.fit.mean(data, points)
        noise = residuals[nearest].reshape(len(points), -1)
        noise = noise - noise.mean(axis=1, keepdims=True) if measured.noisy else np.zeros((len(points), 1))
        variance = noise.var(axis=1) / np.maximum(method.coming.left, 1.0)
        covariance = self.fit.covariance(data, points) + np.diag(variance)
        rng = np.random.default_rng(0)
        errors = rng.multivariate_normal(np.zeros(len(points)), covariance, DRAWS, check_valid="ignore", method="eigh")
        return method.coming.forecast(list(means[:, None] + noise), errors)


def division(rollouts: int, parameters: int) -> tuple[int, int]:
    """Return tests and replicates of about so many rollouts.

    >>> [division(rollouts, 2) for rollouts in (100, 400, 1600)]
    [(50, 2), (100, 4), (100, 16)]
    """
    points = points_per_parameter(parameters, rollouts, 1)
    tests = min(max(FEWEST_TESTS, TESTS_OF_A_POINT * most_points(parameters, points)), rollouts)
    return tests, max(1, round(rollouts / tests))
