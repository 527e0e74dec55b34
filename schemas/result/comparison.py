"""The comparison of two systems, as `perfbound compare` writes it."""

from typing import Literal

from pydantic import Field

from ..base import Model
from ..system import OptionValue

ComparisonVerdict = Literal["BETTER", "WORSE", "EQUAL", "UNDECIDED"]
ComparedQuantity = Literal["mean", "failure_probability", "worst_start", "worst_case"]
Common = Literal["starts", "seeds", "disturbances"]


class ComparedSystem(Model):
    """One of the two systems."""

    campaign: str = Field(description="the campaign file, or the run directory, that was given")
    system: str = Field(description="the system as a worker finds it")
    options: dict[str, OptionValue] = Field(description="the options that its campaign file sets")
    revision: str | None = Field(description="the commit of its folder, where git knows one")
    system_sha256: str = Field(description="digest of the description and the sources of the system")
    certificate_sha256: str = Field(description="digest of the certificate of its rollouts")


class Difference(Model):
    """One quantity of B less that of A."""

    quantity: ComparedQuantity = Field(
        description="`mean`: of the robustness; `failure_probability`; `worst_start`: the least mean robustness of the "
        "listed starts; `worst_case`: the least robustness over all starts, of noisy rollouts the least mean"
    )
    better: Literal["larger", "smaller"] = Field(description="which values are better")
    a: float = Field(description="estimate of A, which is no bound")
    b: float = Field(description="estimate of B, which is no bound")
    lower: float = Field(description="B - A is at least this")
    upper: float = Field(description="B - A is at most this")
    equal_within: float | None = Field(description="a difference that does not matter")
    verdict: ComparisonVerdict
    unit: str = Field(description="of the bounds; empty for a probability")


class Comparison(Model):
    """The comparison of a system B with a system A, from rollouts in pairs or from two bounds of the worst case."""

    format: Literal["perfbound-comparison-1"] = "perfbound-comparison-1"
    a: ComparedSystem
    b: ComparedSystem
    specification: str
    clip: tuple[float, float] | None
    pairs: int = Field(ge=0, description="starts, each with one rollout of either system; 0 of the worst case")
    most_pairs: int = Field(ge=0, description="the largest number that was asked for")
    common: tuple[Common, ...] = Field(description="what the two rollouts of a pair share")
    probability: float = Field(
        gt=0, lt=1, description="least probability that all intervals contain their differences, after every pair"
    )
    differences: tuple[Difference, ...]
    verdict: ComparisonVerdict = Field(
        description="WORSE where one difference is; else UNDECIDED where one is; else BETTER where one is; else EQUAL"
    )
