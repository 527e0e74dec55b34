"""How long the rollouts of a calibrated campaign take."""

from ...schemas.file.config import CampaignConfig
from .first_size import LEAST_COST, PER_SECOND, WORKERS
from .plan import ProblemPlan

__all__ = ["WORKERS", "rollout_time"]


def rollout_time(config: CampaignConfig, plan: ProblemPlan, cost: float, *, tests: int) -> tuple[int, float]:
    """Return the rollouts of so many tests with the closing checks, and their seconds with `WORKERS`.

    `cost` are the seconds of one rollout.
    """
    closing = (config.spot_check + config.recheck) * len(plan.variants)
    rollouts = tests * len(plan.rollouts) + closing
    return rollouts, rollouts / min(PER_SECOND, WORKERS / max(cost, LEAST_COST))
