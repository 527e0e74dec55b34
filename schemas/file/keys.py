"""Every key of a campaign file: its unit, its range and its meaning."""

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator

from ..base import Model, key_if_given
from ..ranges import LARGEST_BATCH
from ..values import Beyond
from .composition import ComposedClaim, Rule, is_composed
from .disturbance import MAX_DISTURBANCES, Disturbance
from .drawn_claims import SAMPLED, ClaimRequest, DrawnClaim, drawn_claims
from .logs import MAX_LOGS, RecordedTest
from .method_spaces import CELLS_OF_MORE, MAX_CANDIDATES, MOST_STARTS, RESOLUTION, fixed_starts, nodes_per_parameter
from .objectives import OBJECTIVES, Sense
from .problem_models import Falsify, Gap, Problem, SampleProblem
from .requirements import MOST, Requirement, conjunction
from .space import Space, SystemChoice


def most_kept(keep: str) -> int | None:
    """Return N of `keep = "worst N"`; None for the other values.

    >>> most_kept("worst 1000"), most_kept("failures")
    (1000, None)
    """
    return int(keep.removeprefix("worst ")) if keep.startswith("worst ") else None


class CampaignSize(Model):
    """Name, seed and size of a campaign; a problem may have its own size."""

    name: str = Field(
        pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$",
        description="names the run directory; seeds follow from it, `seed`, and all other keys that decide a number",
    )
    seed: int = Field(default=1, ge=0, lt=2**53, description="other seeds for the same campaign; `--seed` overrides it")
    window: int = Field(default=1, ge=1, le=10_000, description="tests in flight per problem")
    replicates: int = Field(default=1, ge=1, le=100_000, description="rollouts per test and variant")
    resolution: int = Field(
        default=RESOLUTION,
        ge=2,
        description=f"lattice nodes per parameter; at most {MAX_CANDIDATES:,} in all; that of `kriging` is by "
        f"default, with 4, 5 or 6 parameters, {', '.join(map(str, CELLS_OF_MORE.values()))}",
    )
    max_tests: int = Field(default=2000, ge=1, le=1_000_000, description="largest number of tests per problem")

    def window_of(self, problem: Problem) -> int:
        """Return the tests in flight of one problem."""
        return problem.window or self.window

    def replicates_of(self, problem: Problem) -> int:
        """Return the rollouts per test and variant of one problem."""
        return problem.replicates or self.replicates

    def max_tests_of(self, problem: Problem) -> int:
        """Return the budget of one problem."""
        return problem.max_tests or self.max_tests


Asked = Annotated[
    Annotated[ClaimRequest, Tag("drawn")] | Annotated[ComposedClaim, Tag("composed")],
    Discriminator(lambda asked: "composed" if is_composed(asked) else "drawn"),
]
"""An entry of `[[claims]]`."""


class CampaignKeys(CampaignSize):
    """All keys of a campaign file, each valid by itself."""

    horizon: float = Field(
        default=0.0, ge=0, description="duration of a rollout in s; 0 for a function, whose rollout is one sample"
    )
    risk_weight: float = Field(default=0.2, gt=0, description="r of the risk E[rho] - r sd[rho]")
    clip: tuple[float, float] | None = Field(
        default=None,
        description="[-m, M]: range to which robustness is clipped; not needed by `maximum`, nor by `robustness` with "
        "`noise_scale = 0`",
    )
    specification: str | None = Field(
        default=None,
        max_length=10_000,
        description="STL formula over the columns; required by every problem but `maximum`",
    )
    specifications: tuple[Requirement, ...] = Field(
        default=(),
        max_length=MOST,
        exclude_if=lambda requirements: requirements == (),
        description="several requirements instead of `specification`; not with method `paper`",
    )
    beyond: Beyond = Field(
        default="refuse",
        exclude_if=lambda choice: choice == "refuse",
        description="a specification whose windows reach beyond the horizon: refused, or (`truncate`) each window ends "
        "with the rollout, and over no sample `always` is true and `eventually` false; the claim says so",
    )
    required_margin: float = Field(
        default=0.0,
        exclude_if=lambda margin: margin == 0,
        description="for the verdict, if the first claim is a bound from below: its least margin",
    )
    required_at_most: float | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="for the verdict, if the first claim is a bound from above, as of a failure probability: largest "
        "acceptable value; without it such a claim is never `SHOWN`",
    )
    required_probability: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        exclude_if=lambda value: value is None,
        description="for the verdict: least probability of the first claim; by default 1 - delta",
    )
    gap: Gap | None = Field(
        default=None, description="how `sim_gap` compares two trajectories; required by it, here or in the problem"
    )
    composition: Rule = Field(
        default="single",
        description="rule of the first claim; claims by the other allowed rules follow",
    )
    falsify: Falsify | None = Field(
        default=None,
        exclude_if=lambda falsify: falsify is None,
        description="search for a counterexample: tests go where robustness below 0 is expected; implies "
        "`until_counterexample`, unless its own `until` is another",
    )
    until_counterexample: bool = Field(
        default=False,
        validate_default=True,
        description="end with the first test, in test order, of which a rollout violates the specification; for one "
        "problem of the robustness, not with method `paper`",
    )
    anytime: bool = Field(
        default=False,
        exclude_if=lambda anytime: not anytime,
        description="of drawn starts: claims hold after every test, and not at `max_tests` alone, so that results may "
        "decide to continue beyond it; their bounds are wider",
    )
    on_refuted: Literal["continue", "stop"] = Field(
        default="continue",
        exclude_if=lambda choice: choice == "continue",
        description="what a problem does when its tests refute an assumption; `stop` is for methods `rigorous` and "
        "`scenario`, without spot check. A problem whose bounds contradict its constants always ends",
    )
    regions: bool = Field(
        default=False,
        exclude_if=lambda regions: not regions,
        description="divide D into boxes certified safe, certified unsafe or undecided; for one problem of the "
        "robustness on a box, by method `rigorous`",
    )
    batch: int = Field(
        default=1,
        ge=1,
        le=LARGEST_BATCH,
        exclude_if=lambda batch: batch == 1,
        description="rollouts of one assignment, in one file: those of a test, or of consecutive tests whose starts no "
        "rollout decides",
    )
    keep: str = Field(
        default="all",
        pattern=r"^(all|failures|worst [1-9]\d{0,4})$",
        exclude_if=lambda keep: keep == "all",
        description='which rollouts of a batch keep their samples: all, `"failures"`, or `"worst 1000"`; of the others '
        "start, seed, digest and robustness are left, and `verify --resimulate` repeats them",
    )
    visual: Literal["all", "none"] = Field(
        default="all",
        description="whether trajectory files have a visual part for viewers; `perfbound replay --mcap` draws it where "
        "they have none",
    )
    max_attempts: int = Field(
        default=5,
        ge=1,
        le=1000,
        description="failed attempts of one rollout that end the campaign; two if the system fails alike or misses the "
        "deadline",
    )
    hung_after: float = Field(
        default=10.0,
        ge=1,
        description="s without progress that end an attempt of a system that shows its progress",
    )
    deadline: float = Field(
        default=600.0, ge=1, description="longest attempt in s; of a batch that for each of its rollouts"
    )
    second_opinion: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of the rollouts that two workers simulate; these count if both agree bit by bit",
    )
    platform: str | None = Field(
        default=None,
        pattern=r"^[a-z0-9][a-z0-9._?-]{0,150}$",
        description="class of machines (CPU, C library) of the workers, or `any`: then rollouts may differ in the last "
        "bits; by default that of the first orchestrator",
    )
    spot_check: int = Field(
        default=299,
        ge=0,
        le=100_000,
        description="fresh starts on a box that test every bound after the problems have ended",
    )
    spot_check_followups: int = Field(
        default=299, ge=0, le=1_000_000, description="further rollouts at suspicious starts, if values are noisy"
    )
    spot_replicates: int = Field(
        default=1, ge=1, le=1000, description="rollouts of each test of the spot check, if values are noisy"
    )
    recheck: int = Field(
        default=20, ge=0, le=10_000, description="recorded rollouts that are simulated again before the certificate"
    )
    system: SystemChoice = Field(description="the system under test")
    disturbances: dict[str, Disturbance] = Field(
        default_factory=dict,
        max_length=MAX_DISTURBANCES,
        exclude_if=lambda laws: not laws,
        description="other laws of disturbances that the system declares; of a program, which declares none, all",
    )
    control: Literal["on", "off"] = Field(
        default="on",
        exclude_if=lambda control: control == "on",
        description="whether bounds of means take out what declared disturbances explain of rollouts: those of method "
        "`kriging` and `scenario`, and of `sample` all but failures, quantiles and the next rollout",
    )
    space: Space = Field(description="D, all starting conditions")
    where: str | None = Field(
        default=None,
        max_length=10_000,
        exclude_if=lambda where: where is None,
        description="condition on the parameters, such as `x^2 + y^2 <= 25`; also under `[space]`; not with method "
        "`paper`",
    )
    candidates: int | None = Field(
        default=None,
        ge=2,
        le=MOST_STARTS,
        exclude_if=lambda candidates: candidates is None,
        description="with `rigorous` or `scenario` on ranges: the claim is about so many starts of the box alone, its "
        "corners and a Sobol sequence",
    )
    problems: tuple[Annotated[Problem, Field(discriminator="method")], ...] = Field(
        min_length=1,
        description="optimisation problems; a single `robustness` may have its keys at the top level",
    )
    claims: tuple[Asked, ...] = Field(
        default=(),
        max_length=100,
        exclude_if=lambda claims: claims == (),
        description="what is claimed, the answer to the question of the file first",
    )

    draws: str | None = key_if_given(
        "campaigns with the same text draw the same starts, and give the same seeds to rollouts with the same "
        "numbers; by default both follow from the whole file. `perfbound compare` writes it",
        pattern=r"^[0-9a-f]{64}$",
    )
    recorded: tuple[RecordedTest, ...] = Field(
        default=(),
        max_length=MAX_LOGS,
        exclude_if=lambda tests: tests == (),
        description="the tests of logs, in their order; `perfbound import` writes it",
    )

    @field_validator("until_counterexample")
    @classmethod
    def _implied(cls, given: bool, info: ValidationInfo) -> bool:
        falsify = info.data.get("falsify")
        return given or (falsify is not None and falsify.until == "counterexample")

    @property
    def at_every_moment(self) -> bool:
        """Whether claims hold after every test: outcomes may end the campaign, or it may be continued."""
        return self.may_end_early or self.anytime

    @property
    def may_end_early(self) -> bool:
        """Whether outcomes may end the campaign before its budget, besides a tolerance."""
        return self.until_counterexample or self.falsify is not None

    @property
    def formula(self) -> str | None:
        """The specification; of several requirements that every one of them holds."""
        formulas = [each.formula for each in self.specifications]
        return conjunction(formulas) if formulas else self.specification

    def claims_of(self, problem: Problem) -> tuple[DrawnClaim, ...]:
        """Return what is claimed of drawn starts, the first claim first; empty for a problem that draws none.

        What is asked is claimed of the whole specification, then of each requirement.
        """
        if not isinstance(problem, SampleProblem):
            return ()
        asked = drawn_claims(self.claims) or (ClaimRequest(quantity="failure_probability"),)
        names = (None, *(each.name for each in self.specifications))
        share = problem.delta / (len(asked) * len(names) if problem.jointly else 1)
        return tuple(
            DrawnClaim(each, each.failure_probability or share, name, place)
            for each in asked
            for place, name in enumerate(names)
        )

    def sense_of(self, problem: Problem) -> Sense:
        """Return whether a problem bounds a minimum from below or a maximum from above."""
        for claim in self.claims_of(problem)[:1]:
            return "min" if SAMPLED[claim.asked.quantity].sense == ">=" else "max"
        return OBJECTIVES[problem.name].sense

    def gap_of(self, problem: Problem) -> Gap | None:
        """Return the gap of one problem; None for one that compares no trajectories."""
        return problem.gap or self.gap if OBJECTIVES[problem.name].measured == "gap" else None

    def resolution_of(self, problem: Problem) -> int:
        """Return the lattice nodes per parameter of one problem."""
        return nodes_per_parameter(problem.method, self.space, problem.resolution or self.resolution)

    def starts_of(self, problem: Problem) -> int | None:
        """Return how many listed starts of the box a problem chooses from; None for a lattice, a list and draws."""
        return fixed_starts(problem.method, self.space, self.candidates)
