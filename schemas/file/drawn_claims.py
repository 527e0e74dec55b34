"""The claims that a campaign file asks of drawn starts: one row of properties for each quantity.

A new quantity is a name and a row here, and a row of `orchestrator.mathematics.bounds.sample`.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, cast

from pydantic import Field, model_validator

from ..base import Model
from ..values import SampledQuantity
from .objectives import Quantity, Reading, any_of


@dataclass(frozen=True, slots=True)
class Sampled:
    """The properties of one quantity of rollouts at drawn starts."""

    sense: Literal[">=", "<="]
    words: str
    """`{level}` is replaced by the level in per cent, `{clipped}` by the clip, `{of}` by the requirement, if any."""
    level: str = ""
    """The meaning of the key `level`; empty for a quantity without one."""
    clip: bool = True
    """Whether a bound needs a clip."""
    shifted: bool = True
    """Whether there is a bound for every distribution within a factor of the declared one."""
    reading: Reading = "each"
    """How it reads the values of rollouts; of starts without noise every mean is one value."""


SAMPLED: Mapping[SampledQuantity, Sampled] = {
    "failure_probability": Sampled(
        "<=", "probability that a rollout at a drawn start violates {specification}", clip=False, reading="sign"
    ),
    "quantile": Sampled(
        ">=",
        "{level} quantile of the robustness{of} at drawn starts{clipped}",
        level="share of the rollouts below the quantile",
        clip=False,
    ),
    "cvar": Sampled(
        ">=",
        "mean of the worst {level} of the robustness{of} at drawn starts (CVaR){clipped}",
        level="share of the worst rollouts, whose mean is bounded",
        reading="mean",
    ),
    "mean": Sampled(">=", "mean robustness{of} at drawn starts{clipped}", reading="mean"),
    "risk": Sampled(">=", "robustness risk E - r sd{of} at drawn starts{clipped}", shifted=False, reading="risk"),
    "share_of_starts": Sampled(
        ">=", "{value}{of} on all starts but {level}{clipped}", level="share of the starts that is left out", clip=False
    ),
    "next_rollout": Sampled(
        ">=",
        "robustness{of} of the next rollout at a drawn start{clipped}",
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
        description="Lambda: the claim holds for every distribution of the starts with at most so many times the "
        "declared density",
    )
    delta: float | None = Field(default=None, gt=0, lt=1, description="failure probability of this claim")

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

    @property
    def failure_probability(self) -> float | None:
        """That of this claim alone; None where it is that of the problem."""
        return self.level if self.quantity in UP_TO_CHANCE else self.delta


@dataclass(frozen=True, slots=True)
class DrawnClaim:
    """A claim about drawn starts: of the whole specification, or of one requirement."""

    asked: ClaimRequest
    delta: float
    requirement: str | None = None
    place: int = 0
    """Of the requirement in the file, from 1; 0 for the whole."""

    def words(self, value: str, clip: tuple[float, float] | None) -> str:
        """Return the subject; `value` is what a start has, its robustness or the expectation of it.

        >>> DrawnClaim(ClaimRequest(quantity="cvar", level=0.01), 0.05).words("robustness", (-1.0, 2.0))
        'mean of the worst 1 % of the robustness at drawn starts (CVaR), clipped to [-1, 2]'
        """
        asked, name = self.asked, self.requirement
        text = SAMPLED[asked.quantity].words.format(
            level=f"{100 * (asked.level or 1.0):.6g} %",
            value=value,
            clipped="" if clip is None else f", clipped to [{clip[0]:g}, {clip[1]:g}]",
            specification="the specification" if name is None else f"requirement {name}",
            of="" if name is None else f" of requirement {name}",
        )
        if asked.factor == 1:
            return text
        return f"{text}, for every distribution with at most {asked.factor:g} times the declared density"


def drawn_claims(asked: Iterable[object]) -> tuple[ClaimRequest, ...]:
    """Return the claims about drawn starts among the entries of `[[claims]]`."""
    return tuple(each for each in asked if isinstance(each, ClaimRequest))


def is_sampled(quantity: Quantity) -> bool:
    """Whether a claim is about rollouts at drawn starts."""
    return quantity in SAMPLED


def fewest_samples(claim: DrawnClaim) -> int:
    """Return the least number of samples, fixed beforehand, with which a claim about the order of values has a bound.

    Formula: (1 - q)^n <= delta with q = level/factor for a quantile, 1/(n + 1) <= q for the next rollout.

    >>> fewest_samples(DrawnClaim(ClaimRequest(quantity="quantile", level=0.05), 0.05))
    59
    >>> fewest_samples(DrawnClaim(ClaimRequest(quantity="next_rollout", level=0.05), 0.05))
    19
    """
    share = (claim.asked.level or 1.0) / claim.asked.factor
    if claim.asked.quantity in UP_TO_CHANCE:
        return math.ceil(1 / share - 1e-9) - 1
    return math.ceil(math.log(claim.delta) / math.log1p(-share)) if share < 1.0 else 1
