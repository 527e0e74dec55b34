"""The claims that a campaign file asks of drawn starts: one row of properties for each quantity.

A new quantity is a name and a row here, and a row of `orchestrator.mathematics.bounds.sample`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast

from pydantic import Field, model_validator

from .base import Model
from .problems import Quantity, any_of
from .values import SampledQuantity


@dataclass(frozen=True, slots=True)
class Sampled:
    """The properties of one quantity of rollouts at drawn starts."""

    sense: Literal[">=", "<="]
    words: str
    """`{level}` is replaced by the level in per cent, `{clipped}` by the clip."""
    level: str = ""
    """The meaning of the key `level`; empty for a quantity without one."""
    clip: bool = True
    """Whether a bound needs a clip."""
    shifted: bool = True
    """Whether there is a bound for every distribution within a factor of the declared one."""


SAMPLED: Mapping[SampledQuantity, Sampled] = {
    "failure_probability": Sampled(
        "<=", "probability that a rollout at a drawn start violates the specification", clip=False
    ),
    "quantile": Sampled(
        ">=",
        "{level} quantile of the robustness at drawn starts",
        level="share of the rollouts below the quantile",
        clip=False,
    ),
    "cvar": Sampled(
        ">=",
        "mean of the worst {level} of the robustness at drawn starts (CVaR){clipped}",
        level="share of the worst rollouts, whose mean is bounded",
    ),
    "mean": Sampled(">=", "mean robustness at drawn starts{clipped}"),
    "risk": Sampled(">=", "robustness risk E - r sd at drawn starts{clipped}", shifted=False),
    "share_of_starts": Sampled(
        ">=", "{value} on all starts but {level}{clipped}", level="share of the starts that is left out", clip=False
    ),
    "next_rollout": Sampled(
        ">=",
        "robustness of the next rollout at a drawn start",
        level="probability with which the next rollout may be below the bound",
        clip=False,
    ),
}
PROBABILITIES: frozenset[Quantity] = frozenset({"failure_probability"})
"""Quantities without a unit; all others have that of the robustness."""
UP_TO_CHANCE: frozenset[SampledQuantity] = frozenset({"next_rollout"})
"""Quantities whose level is the failure probability of the claim, over the samples and what follows them."""


class ClaimRequest(Model):
    """A claim that is asked for."""

    quantity: SampledQuantity = Field(description="what is bounded, of rollouts at drawn starts")
    level: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="; ".join(f"`{name}`: {each.level}" for name, each in SAMPLED.items() if each.level),
    )
    factor: float = Field(
        default=1.0,
        ge=1,
        le=1e6,
        description="Lambda: the claim holds for every distribution of the starts whose density is at most so many "
        "times the declared one",
    )
    delta: float | None = Field(
        default=None, gt=0, lt=1, description="failure probability of this claim; by default that of the problem"
    )

    @model_validator(mode="after")
    def _consistent(self) -> "ClaimRequest":
        row = SAMPLED[self.quantity]
        if row.level and self.level is None:
            raise ValueError(f"level: required by {self.quantity!r}: {row.level}, in (0, 1)")
        if not row.level and self.level is not None:
            leveled = cast("tuple[str, ...]", tuple(name for name, each in SAMPLED.items() if each.level))
            raise ValueError(f"level: only {any_of(leveled)} has one, not {self.quantity!r}; remove this key")
        if not row.shifted and self.factor != 1:
            raise ValueError(f"factor: no bound of {self.quantity!r} is known for other distributions; remove this key")
        if self.quantity in UP_TO_CHANCE and self.delta is not None:
            raise ValueError(f"delta: the level of {self.quantity!r} is its failure probability; remove this key")
        return self


def words(claim: ClaimRequest, value: str, clip: tuple[float, float] | None) -> str:
    """Return the subject of a claim; `value` is what a start has, its robustness or the expectation of it.

    >>> words(ClaimRequest(quantity="cvar", level=0.01), "robustness", (-1.0, 2.0))
    'mean of the worst 1 % of the robustness at drawn starts (CVaR), clipped to [-1, 2]'
    """
    clipped = "" if clip is None else f", clipped to [{clip[0]:g}, {clip[1]:g}]"
    level = f"{100 * (claim.level or 1.0):.6g} %"
    text = SAMPLED[claim.quantity].words.format(level=level, value=value, clipped=clipped)
    if claim.factor == 1:
        return text
    return f"{text}, for every distribution with at most {claim.factor:g} times the declared density"


def fewest_samples(claim: ClaimRequest, delta: float) -> int:
    """Return the least number of samples, fixed beforehand, with which a claim about the order of values has a bound.

    Formula: (1 - q)^n <= delta with q = level/factor for a quantile, 1/(n + 1) <= q for the next rollout.

    >>> fewest_samples(ClaimRequest(quantity="quantile", level=0.05), 0.05)
    59
    >>> fewest_samples(ClaimRequest(quantity="next_rollout", level=0.05), 0.05)
    19
    """
    share = (claim.level or 1.0) / claim.factor
    if claim.quantity in UP_TO_CHANCE:
        return math.ceil(1 / share - 1e-9) - 1
    return math.ceil(math.log(delta) / math.log1p(-share)) if share < 1.0 else 1


def is_sampled(quantity: Quantity) -> bool:
    """Whether a claim is about rollouts at drawn starts."""
    return quantity in SAMPLED
