"""What is known of a campaign: its verdict at the end; until then what it has shown, and where it will end."""

from typing import Literal

from pydantic import Field

from ..base import Model
from .certificate import Assumption

VerdictWord = Literal["SHOWN", "VIOLATED", "NOT SHOWN"]
ByRollouts = Literal["certain", "probable"]
CampaignState = Literal["running", "stopped", "finished"]


class Violations(Model):
    """The rollouts of the tested system with a robustness below 0, of all that the bounds and closing checks use."""

    rollouts: int = Field(ge=0)
    violations: int = Field(ge=0)
    starts: int = Field(ge=0, description="at which there are rollouts; each test of a block counts as one")
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
    rests_on: str = Field(
        default="",
        description="of SHOWN: the constants of which twice the norm bound, or half the length scales, would leave NOT "
        "SHOWN; empty where each of these is still SHOWN",
    )
    without_kernel: str = Field(
        default="", description="beside `rests_on`: what fresh starts prove without these constants, in a sentence"
    )
    clipped: bool = Field(default=False, description="whether the worst robustness is at the lower clip, or below it")
    repeat: str = Field(description="command that simulates the worst rollout again; empty where none violates")


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


class KnownProblem(Model):
    """The progress of one problem."""

    name: str
    tests: int
    most_tests: int = Field(description="its budget")
    rollouts: int
    bound: float | None = Field(description="that holds now, in the sense of the problem")
    distance: float | None = Field(description="what has to fall to alpha")
    alpha: float | None
    stopped_by: str | None


class KnownAttempts(Model):
    """Attempts at rollouts that brought no result."""

    without_result: int
    failed_in_system: int = Field(description="of those without a result")
    handed_back: int = Field(description="by workers that ended; they are no failures")


class KnownCampaign(Model):
    """The state of a campaign, for programs: `perfbound status --json`."""

    campaign: str
    seed: int
    run: str
    state: CampaignState
    verdict: CampaignVerdict | None = Field(description="of a finished campaign")
    so_far: SoFar | None = Field(description="of one that is not")
    problems: tuple[KnownProblem, ...]
    rollouts_per_second: float
    router_link_down_for: float | None = Field(description="s without a link to the router; null with one")
    attempts: KnownAttempts
    resume: str | None = Field(description="the command that continues a stopped campaign")
