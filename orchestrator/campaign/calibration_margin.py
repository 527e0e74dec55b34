"""What the campaign file requires, where a calibration chooses the tolerance and says what the campaign will prove."""

from ...schemas.file.config import CampaignConfig
from ...schemas.file.problem_models import Problem

SHARE = 0.5
"""Of the distance between the worst start and what is required, the part that the tolerance may take."""


def required_objective(config: CampaignConfig, problem: Problem) -> float | None:
    """Return the largest J that meets what is required; None where the first claim is not that of one objective."""
    if len(config.problems) != 1 or config.specifications or getattr(problem, "linearised", None) is not None:
        return None
    return -config.required_margin if config.sense_of(problem) == "min" else config.required_at_most


def forecast_margin_words(config: CampaignConfig, problem: Problem, expected: float, worst: float) -> str:
    """Return whether a forecast bound on J meets what is required; empty where nothing is.

    `worst` is the largest J of the fitted function, below which no bound may be expected to fall.
    """
    limit = required_objective(config, problem)
    if limit is None:
        return ""
    sign, sense = (-1, "at least") if config.sense_of(problem) == "min" else (1, "at most")
    words = f"the bound would be about {sign * expected:.3g} then, and {sense} {sign * limit:.3g} is required"
    if expected <= limit:
        return words
    if worst > limit:
        fitted = f"the worst start of the fitted function has {sign * worst:.3g}"
        return f"{words}, but {fitted}: if that is so, no tolerance and no budget will show it"
    return f"{words}: a smaller alpha, or where that is out of reach more replicates, would come nearer"
