"""What the clip alone proves, before any rollout: no bound is worth more attention that says no more."""

from ...schemas.campaign import CampaignConfig
from ...schemas.claims import ClaimRequest
from ...schemas.problem_models import Problem
from ...schemas.problems import OBJECTIVES
from ..mathematics.bounds.risk import RiskReading
from ..mathematics.bounds.rounding import round_down, round_up

SAME = 2e-9
"""Bounds are rounded outward to 1e-9: two roundings of one number differ by less than this."""


def least_risk(config: CampaignConfig) -> float | None:
    """Return the least risk that a law on the clip can have, rounded down; None without a clip."""
    return None if config.clip is None else RiskReading(config.clip, config.risk_weight, None).least


def by_clip(config: CampaignConfig, problem: Problem) -> float | None:
    """Return what the clip alone proves of an objective, rounded outward; None where it limits nothing.

    A lower bound for sense min, an upper one for sense max.
    """
    for claim in config.claims_of(problem)[:1]:
        return of_drawn_starts(config, claim.asked)
    if config.clip is None or OBJECTIVES[problem.name].measured == "column":
        return None  # a column has no clip
    low, high = config.clip
    if OBJECTIVES[problem.name].risk:
        return least_risk(config)
    if OBJECTIVES[problem.name].sense == "min":
        return round_down(low)
    gap = config.gap_of(problem)
    # Method paper does not clip a sup gap. Elsewhere no two clipped values differ by more than M + m.
    if gap is None or (problem.method == "paper" and gap.kind != "robustness"):
        return None
    return round_up((high - low) / gap.lipschitz)


def of_drawn_starts(config: CampaignConfig, claim: ClaimRequest) -> float | None:
    """Return what is proven of a claim about drawn starts without any rollout; None where nothing is."""
    if claim.quantity == "failure_probability":
        return 1.0
    if claim.quantity == "risk":
        return least_risk(config)
    return None if config.clip is None else round_down(config.clip[0])


def floored(bound: float, sense: str, limit: float | None) -> float:
    """Return a bound that is not weaker than what the clip alone proves; `sense` is one of >=, min, <=, max.

    >>> floored(-0.3, ">=", -0.05), floored(0.9, "max", 0.8), floored(0.9, "max", None)
    (-0.05, 0.8, 0.9)
    """
    if limit is None:
        return bound
    return max(bound, limit) if sense in {">=", "min"} else min(bound, limit)


def is_vacuous(bound: float, sense: str, limit: float | None) -> bool:
    """Whether the clip alone proves a bound.

    >>> is_vacuous(-0.05, ">=", -0.05), is_vacuous(0.1, ">=", -0.05), is_vacuous(0.1, "<=", None)
    (True, False, False)
    """
    return limit is not None and abs(floored(bound, sense, limit) - limit) < SAME
