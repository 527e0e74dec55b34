"""The verdict on a campaign: whether the first claim shows what the campaign file requires."""

from typing import Literal

from pydantic import Field

from ..base import Model

VerdictWord = Literal["SHOWN", "VIOLATED", "NOT SHOWN"]
ByRollouts = Literal["certain", "probable"]


class Violations(Model):
    """The rollouts of the tested system with a robustness below 0, of all that the bounds and closing checks use."""

    rollouts: int = Field(ge=0)
    violations: int = Field(ge=0)
    starts: int = Field(ge=0, description="at which there are rollouts")
    violating_starts: int = Field(ge=0)
    least: float | None = Field(description="robustness of the worst rollout, clipped; null without any")
    rollout: str | None = Field(description="the worst one")


class CampaignVerdict(Model):
    """Whether the first claim shows what is required.

    SHOWN: the bound is at or beyond what is required, with the required probability, and nothing that it rests on is
    refuted. VIOLATED: the rollouts show the opposite. NOT SHOWN: neither.
    """

    verdict: VerdictWord
    campaign: str
    seed: int
    claim: str = Field(description="the first claim in words, rounded to the safe side")
    reasons: tuple[str, ...] = Field(description="why it is this verdict, in sentences")
    advice: tuple[str, ...] = Field(description="what would help, in sentences; empty for SHOWN")
    bound: float
    sense: Literal[">=", "<="]
    required: float | None = Field(description="of the bound; null where the file requires nothing of it")
    probability: float
    required_probability: float
    unit: str = Field(description="of the robustness; empty where it has none")
    bound_unit: str = Field(description="of bound and requirement; empty where they have none: a probability")
    by_rollouts: ByRollouts | None = Field(
        default=None,
        description="how the rollouts alone show it, without a kernel; null where they do not",
    )
    violations: Violations
    clip: tuple[float, float] | None = Field(
        default=None,
        description="the verdict is about values that count as the nearer of these two beyond them; null where it is "
        "about the values themselves",
    )
    clipped: bool = Field(default=False, description="whether the worst robustness is at the lower clip, or below it")
    repeat: str = Field(description="command that simulates the worst rollout again; empty where none violates")
