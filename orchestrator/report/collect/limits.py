"""The values that a problem's charts mark, with the sign of the objective: what is required, and the clip."""

import math

import numpy as np
from numpy.typing import NDArray

from ....schemas.file.bases import bases
from ....schemas.file.composition import composes
from ....schemas.file.config import CampaignConfig
from ...campaign.plan import ProblemPlan, value_range
from .observed import signed


def required(config: CampaignConfig, plan: ProblemPlan) -> float | None:
    """Return the bound that the file requires of its first claim; None for a problem that the claim is not about.

    `config` is that of the campaign. A composed claim is about no problem by itself.
    """
    first = bases(config)[0]
    names = {plan.key, *(part.key for part in plan.parts)}
    if composes(first.rule) or names.isdisjoint(first.problems):
        return None
    return config.required_margin if plan.sense == "min" else config.required_at_most


def is_robustness(plan: ProblemPlan) -> bool:
    """Whether the bounded values are a robustness, which is negative for a violation."""
    return plan.objective.measured == "robustness" and plan.sense == "min"


def ends(plan: ProblemPlan) -> tuple[float | None, float | None]:
    """Return the least and the largest value that an observation can have; None where nothing limits it."""
    if plan.candidates is None:
        # The value of a probability has no clip; that of a robustness has its own.
        limited = plan.sense == "min" and math.isfinite(plan.clip[1] - plan.clip[0])
        return plan.clip if limited else (None, None)
    if plan.objective.measured == "gap" and plan.problem.method == "paper":
        return None, None  # the paper clips no gap
    low, high = (signed(value, plan.sense) for value in value_range(plan))
    if plan.sense == "max":
        return low, high
    # A sample risk, mean less r standard deviations, may be below every robustness.
    below = plan.objective.risk and plan.problem.method in ("paper", "scenario")
    return (None if below else high), low


def within(mean: NDArray[np.float64], plan: ProblemPlan) -> NDArray[np.float64]:
    """Return values of J within what an observation of it can be: a model may overshoot, the system cannot."""
    low, high = ends(plan)
    if plan.sense == "min":
        low, high = signed(high, "min"), signed(low, "min")
    return np.clip(mean, -np.inf if low is None else low, np.inf if high is None else high)
