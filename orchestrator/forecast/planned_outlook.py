"""The forecast of a problem whose tests are planned, by the weights of its method; apart, since it loads numpy."""

from dataclasses import dataclass, field

import numpy as np

from ...schemas.values import Guess, ProblemProgress
from ..campaign.methods import ProblemMethod
from ..campaign.plan import ProblemPlan
from ..mathematics.bounds.kriging.method import KrigingMethod
from ..mathematics.gp.kernels import Floats
from .outlook import MORE

RANGE = (0.025, 0.975)
"""Of the draws, the part that a range contains."""
FORECASTS = 20
"""Of a campaign at most: each takes as long as some tests."""


def planned_outlook(plan: ProblemPlan, method: ProblemMethod) -> tuple[Guess, Guess] | None:
    """Return the bound of J at the end of the budget, and what `MORE` rollouts in the plan would gain; else None.

    None for other methods, and before every start of the plan was tested.
    """
    # Of several requirements each has a method of its own, and the campaign has no single bound to forecast.
    if not isinstance(method, KrigingMethod):
        return None
    found = method.outlook(MORE / max(1, len(plan.variants)))
    return None if found is None else (_of_draws(found[0]), _of_draws(found[1]))


def _of_draws(found: Floats) -> Guess:
    low, middle, high = np.quantile(found, (RANGE[0], 0.5, RANGE[1])).tolist()
    return Guess(middle, low, high)


@dataclass(slots=True)
class PlannedOutlooks:
    """The forecasts of a run, made anew after a part of the tests."""

    _made: dict[str, tuple[int, tuple[Guess, Guess] | None]] = field(default_factory=dict)

    def of(self, plan: ProblemPlan, method: ProblemMethod, progress: ProblemProgress) -> tuple[Guess, Guess] | None:
        """Return the forecast of a problem, at most a twentieth of its tests old."""
        at, found = self._made.get(plan.key, (-plan.budget, None))
        due = progress.tests - at >= max(1, plan.budget // FORECASTS)
        if due or (progress.stopped_by is not None and at != progress.tests):
            found = planned_outlook(plan, method)
            self._made[plan.key] = progress.tests, found
        return found
