"""What a running campaign has shown so far, and what is expected at its end; derived from its facts, and no fact."""

from typing import Literal

from pydantic import Field

from ..base import Model
from .certificate import Assumption
from .verdict import VerdictWord, Violations


class Span(Model):
    """A guess with its range."""

    low: float
    middle: float
    high: float


class Expected(Model):
    """The forecast of the end; a guess, and no claim."""

    share: float = Field(ge=0, le=1, description="of the work that is done, by the forecast where there is one")
    by_budget: bool = Field(description="whether `share` is of the budget, because there is no forecast")
    tests: Span | None = Field(description="of all problems together at the end; null where nothing is known")
    most_tests: int = Field(description="of all problems together, by their budgets")
    seconds: Span | None = Field(description="left from the moment of this text, at the rate of then")
    bound: Span | None = Field(description="of the first claim at its end, in its sense; null without a forecast")
    verdict: VerdictWord | None = Field(description="where the whole range of the bound has the same one")


class SoFar(Model):
    """The state of a campaign that has not ended, as its orchestrator has last written it."""

    run: str
    at: float = Field(description="Unix time")
    tests: int
    rollouts: int
    verdict: VerdictWord = Field(description="if the campaign ended now")
    claim: str = Field(description="what is proven so far, in words; empty while nothing is")
    reasons: tuple[str, ...] = Field(description="why it is this verdict, in sentences")
    bound: float | None
    refuted: bool = Field(description="whether the bound rests on a refuted assumption: do not rely on it")
    sense: Literal[">=", "<="]
    required: float | None
    probability: float | None
    unit: str = Field(description="of the robustness")
    bound_unit: str = Field(description="of bound and requirement; empty where they have none: a probability")
    violations: Violations
    assumptions: tuple[Assumption, ...] = Field(description="those that were tested so far, refuted ones first")
    others: tuple[str, ...] = Field(description="ids of those assumptions that only further claims rest on")
    on_refuted: Literal["continue", "stop"]
    expected: Expected
    link_down_since: float | None = Field(
        default=None,
        description="Unix time since which the orchestrator has no link to its router; absent while it has one, and "
        "where it needs none",
        exclude_if=lambda since: since is None,
    )
