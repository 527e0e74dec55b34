"""What the clip alone proves, before any rollout, and what it hides.

Which statements about clipped values X' = min(max(X, low), high) are true of the values X themselves? An end of the
clip that no value can be beyond hides nothing (`reach`). Of the others:

| statement         | low hides | high hides | why                                                                 |
|-------------------|-----------|------------|---------------------------------------------------------------------|
| sign of X         | no        | no         | 0 is inside of every clip                                           |
| X >= bound        | if beyond | no         | clipping is monotone: order and quantiles inside of the clip stay   |
| X <= bound        | no        | if beyond  | the same, from the other side                                       |
| E[X] >= bound     | yes       | no         | clipping from below raises the mean, from above it lowers it        |
| E[X] <= bound     | no        | yes        | the same, from the other side                                       |
| E - r sd >= bound | yes       | yes        | every clip lowers sd: X' is a contraction of X                      |
| E - r sd <= bound | no        | yes        | clipping from below raises E and lowers sd, and so raises the risk  |
"""

from functools import cache

from ...schemas.file.config import CampaignConfig
from ...schemas.file.drawn_claims import ClaimRequest
from ...schemas.file.objectives import OBJECTIVES, Reading
from ...schemas.file.problem_models import Problem
from ...schemas.system import AfterEnd
from ...schemas.values import Beyond
from ..mathematics.bounds.one_law.risk import RiskReading
from ..mathematics.bounds.rounding import round_down, round_up
from ..mathematics.stl.parser import parse_formula
from ..mathematics.stl.reach import ANY, Range, reach

Clip = tuple[float, float]
SAME = 2e-9
"""Bounds are rounded outward to 1e-9: two roundings of one number differ by less than this."""


@cache
def reach_of(formula: str | None, after_end: AfterEnd | None = None, beyond: Beyond = "refuse") -> Range:
    """Return the range of robustness that a rollout can reach; one that ends early and fails has a share above -1."""
    low, high = ANY if formula is None else reach(parse_formula(formula), beyond)
    return (min(low, -1.0), high) if after_end == "fail" else (low, high)


def hiding(
    clip: Clip | None,
    within: Range,
    reading: Reading,
    sense: str,
    *,
    risk_weight: float = 1.0,
    bound: float | None = None,
) -> Clip | None:
    """Return the clip where a true statement about clipped values may be false of the values; None where it cannot.

    `within` is the range that the values can reach; `sense` is one of >=, min, <=, max; a `bound` that is not known
    yet may be at an end. The table at the head of this module is what decides. The clip is named whether or not a value
    was seen at an end of it: rare falls beyond the clip are what no rollout has shown.

    >>> hiding((-1.0, 1.0), (-3.0, 1.0), "mean", ">="), hiding((-1.0, 1.0), (-3.0, 1.0), "mean", "<=")
    ((-1.0, 1.0), None)
    >>> hiding((-1.0, 1.0), ANY, "each", ">=", bound=0.5), hiding((-1.0, 1.0), ANY, "each", ">=", bound=-1.0)
    (None, (-1.0, 1.0))
    """
    if clip is None or reading == "sign":
        return None
    (low, high), at_least = clip, sense in {">=", "min"}
    below, above = low > within[0], high < within[1]
    if reading == "each":
        beyond = bound is None or (bound <= low if at_least else bound >= high)
        return clip if beyond and (below if at_least else above) else None
    deviates = reading == "risk" and risk_weight > 0.0
    return clip if (at_least and below) or (above and (deviates or not at_least)) else None


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
