"""The campaign file: every key, its unit, its range and its meaning."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .base import Model, digest, merged
from .claims import SAMPLED, UP_TO_CHANCE, Claim, fewest_samples
from .method_spaces import check_space
from .problem_models import Gap, Problem, RigorousProblem, SampleProblem
from .problems import CLAIMS, OBJECTIVES, OF_ROBUSTNESS, MethodName, ProblemName, Sense, any_of
from .space import Space, SystemChoice

Rule = Literal["product", "sum", "bhatia-davis", "pointwise", "single"]

DECIDES_NOTHING = {"visual", "max_attempts", "hung_after", "deadline", "platform", "second_opinion"}
"""Keys that change no number of a campaign, and so neither its identity nor its seeds."""
IDENTIFIES_ALWAYS: Any = {
    "seed": True,
    "composition": True,
    "problems": {"__all__": {"delta": True, "kernel": {"nu": True}}},
}
"""Keys that are part of the identity also at their default: a file that leaves one out is the same campaign as one that
writes it, and files from before these keys had a default keep their identity."""


class CampaignConfig(Model):
    """A whole campaign file."""

    name: str = Field(
        pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$", description="also names the run directory; without it that of the file"
    )
    seed: int = Field(default=1, ge=0, lt=2**53, description="determines every random choice; `--seed` overrides it")
    window: int = Field(default=1, ge=1, le=10_000, description="tests in flight per problem")
    replicates: int = Field(default=1, ge=1, le=100_000, description="rollouts per test and variant")
    resolution: int = Field(default=21, ge=2, description="lattice nodes per parameter")
    max_tests: int = Field(default=2000, ge=1, le=1_000_000, description="largest number of tests per problem")
    horizon: float = Field(
        default=0.0, ge=0, description="duration of a rollout in s; 0 for a function, whose rollout is one sample"
    )
    risk_weight: float = Field(default=0.2, gt=0, description="r of the risk E[rho] - r sd[rho]")
    clip: tuple[float, float] | None = Field(
        default=None,
        description="[-m, M]: range to which robustness is clipped; not needed by `maximum`, nor by `robustness` with "
        "noise_scale = 0",
    )
    specification: str | None = Field(
        default=None,
        max_length=10_000,
        description="STL formula over trajectory columns; required by every problem but `maximum`",
    )
    gap: Gap | None = Field(
        default=None, description="how `sim_gap` compares two trajectories; required by it, here or in the problem"
    )
    composition: Rule = Field(
        default="single",
        description="rule of the first claim: Theorem 2 with multiplied probabilities, or with added failure "
        "probabilities; Bhatia-Davis with two extremes, or pointwise; one problem alone",
    )
    until_counterexample: bool = Field(
        default=False,
        description="end the campaign with the first test, in test order, of which a rollout violates the "
        "specification; for one problem of the robustness, not with method `paper`",
    )
    visual: Literal["all", "none"] = Field(
        default="all", description="trajectory files with a visual part, for viewers: all, or none"
    )
    max_attempts: int = Field(
        default=5,
        ge=1,
        le=1000,
        description="number of failed attempts of one rollout that ends the campaign; two are enough if the system "
        "fails alike or the deadline is missed",
    )
    hung_after: float = Field(
        default=10.0,
        ge=1,
        description="seconds without progress that end an attempt; a function or program that shows none is ended by "
        "`deadline` alone",
    )
    deadline: float = Field(default=600.0, ge=1, description="longest duration of an attempt in s")
    second_opinion: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of the rollouts that two workers simulate, and that count if both agree bit by bit",
    )
    platform: str | None = Field(
        default=None,
        pattern=r"^[a-z0-9][a-z0-9._?-]{0,150}$",
        description="class of machines (CPU, C library) of the workers, as the refusal of a worker names it, or `any`, "
        "with rollouts that may differ in the last bits; by default that of the orchestrator that begins the campaign",
    )
    spot_check: int = Field(
        default=299,
        ge=0,
        le=100_000,
        description="fresh starts on a box that test every bound after the problems have ended",
    )
    spot_check_followups: int = Field(
        default=299, ge=0, le=1_000_000, description="further rollouts at suspicious starts, where values are noisy"
    )
    spot_replicates: int = Field(
        default=1, ge=1, le=1000, description="rollouts of each test of the spot check, where values are noisy"
    )
    recheck: int = Field(
        default=20, ge=0, le=10_000, description="recorded rollouts that are simulated once more before the certificate"
    )
    system: SystemChoice = Field(description="the system under test")
    space: Space = Field(description="D, all starting conditions: a range per parameter, scenarios, or a table")
    problems: tuple[Annotated[Problem, Field(discriminator="method")], ...] = Field(
        min_length=1,
        description="the optimisation problems; without it there is one, `robustness`, and its keys are those of the "
        "top level",
    )
    claims: tuple[Claim, ...] = Field(
        default=(),
        max_length=100,
        exclude_if=lambda claims: claims == (),
        description="what is claimed of drawn starts, the answer to the question of the file first; method `sample` "
        "alone, where the default is `failure_probability`",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "CampaignConfig":
        names = [problem.name for problem in self.problems]
        for repeated in {name for name in names if names.count(name) > 1}:
            raise ValueError(f"problems: {repeated!r} appears twice; list every problem at most once")
        if self.clip is not None and not self.clip[0] < self.clip[1]:
            raise ValueError(f"clip: {list(self.clip)} must be [low, high] with low < high")
        for problem in self.problems:
            self._check_objective(problem)
            self._check_method(problem)
        if self.until_counterexample:
            self._check_until_counterexample(self.problems[0])
        self._check_composition(set(names), {problem.method for problem in self.problems})
        self._check_claims()
        return self

    def _check_objective(self, problem: Problem) -> None:
        objective = OBJECTIVES[problem.name]
        if objective.measured != "column":
            if self.specification is None:
                raise ValueError(f"specification: required by problem {problem.name!r}")
            if self.clip is None:
                self._check_unclipped(problem)
        if self.horizon == 0 and not objective.static:
            raise ValueError(f"horizon: problem {problem.name!r} needs a rollout longer than 0 s")
        if objective.measured == "gap" and self.gap_of(problem) is None:
            raise ValueError('gap: required by problem \'sim_gap\', e.g. { kind = "signal_sup", column = "phi" }')

    def _check_until_counterexample(self, problem: Problem) -> None:
        if len(self.problems) > 1 or problem.name not in OF_ROBUSTNESS:
            raise ValueError(
                f"until_counterexample: only for one problem, {any_of(OF_ROBUSTNESS)}; remove this key, or the other "
                "problems"
            )
        if problem.method == "paper":
            raise ValueError(
                "until_counterexample: method 'paper' has no bound at a test that depends on the outcomes; choose "
                "'rigorous' or 'scenario'"
            )
        if self.clip is not None and self.clip[0] >= 0:
            raise ValueError(
                f"clip: {list(self.clip)} must begin below 0 with until_counterexample, or it hides every violation"
            )

    @staticmethod
    def _check_unclipped(problem: Problem) -> None:
        """Refuse a robustness without a range where a mean, or a difference, has to be bounded."""
        if not OBJECTIVES[problem.name].static:
            raise ValueError(f"clip: required by problem {problem.name!r}")
        if isinstance(problem, SampleProblem):
            return  # its claims decide: most of them are about values of any range
        # Without noise an observation is the value itself, and no mean of a bounded variable.
        if not isinstance(problem, RigorousProblem) or problem.noise_scale != 0:
            raise ValueError(
                f"clip: required by problem {problem.name!r} with noise; give [low, high], or choose method 'rigorous' "
                "with noise_scale = 0 for rollouts that do not depend on the seed"
            )

    def _check_method(self, problem: Problem) -> None:
        where = f"problems.{problem.name}"
        check_space(problem.method, self.space, self.resolution_of(problem), where)
        if problem.method == "paper":
            if OBJECTIVES[problem.name].risk and self.replicates_of(problem) < 2:
                raise ValueError(f"{where}.replicates: a standard deviation needs at least 2 rollouts a test")
            if self.window_of(problem) != 1:
                raise ValueError(f"{where}.window: Algorithm 1 is sequential, method 'paper' allows 1 only")
            if self.max_tests_of(problem) < 2:
                raise ValueError(f"{where}.max_tests: method 'paper' gives no bound before the second test")

    def _check_composition(self, names: set[ProblemName], methods: set[MethodName]) -> None:
        rule = self.composition
        pair = {"nominal_robustness", "sim_gap"}
        if rule == "single":
            if len(names) != 1:
                raise ValueError("composition: 'single' is for one problem; allowed here: 'product', 'sum'")
            if names & pair:
                raise ValueError(f"composition: 'single' makes a claim of {any_of(CLAIMS)} only")
            return
        if not pair <= names:
            raise ValueError(f"composition: {rule!r} needs the problems 'nominal_robustness' and 'sim_gap'")
        if rule == "product" and methods != {"paper"}:
            raise ValueError("composition: 'product' is for method 'paper'; 'sum' holds for every method")
        if rule in ("bhatia-davis", "pointwise") and methods != {"rigorous"}:
            raise ValueError(f"composition: {rule!r} needs method 'rigorous' in both problems")
        resolutions = {self.resolution_of(problem) for problem in self.problems if problem.name in pair}
        if rule == "pointwise" and len(resolutions) != 1:
            raise ValueError("composition: 'pointwise' needs one resolution for both problems")

    def _check_claims(self) -> None:
        sampled = [problem for problem in self.problems if isinstance(problem, SampleProblem)]
        if self.claims and not sampled:
            raise ValueError("claims: only method 'sample' claims anything of drawn starts; choose it, or remove this")
        for number, claim in enumerate(self.claims if sampled else ()):
            self._check_claim(f"claims.{number}", claim, sampled[0])
            if claim in self.claims[:number]:
                raise ValueError(f"claims.{number}: is there twice; list every claim once")
        if sampled and self.clip is not None and self.clip[0] >= 0:
            raise ValueError(f"clip: {list(self.clip)} must begin below 0, or it hides every violation")

    def _check_claim(self, where: str, claim: Claim, problem: SampleProblem) -> None:
        if self.clip is None and SAMPLED[claim.quantity].clip:
            raise ValueError(f"clip: required by {where}, the bound of a mean: give [low, high]")
        if problem.jointly and (claim.delta or claim.quantity in UP_TO_CHANCE):
            raise ValueError(f"jointly: {where} has a failure probability of its own; remove one of the two")
        ordered = claim.quantity in {"quantile", "next_rollout"}
        # With `until_counterexample` their number depends on the outcomes.
        if self.until_counterexample and claim.quantity in UP_TO_CHANCE:
            raise ValueError(
                f"{where}.quantity: {claim.quantity!r} needs a number of samples that is fixed beforehand; remove this "
                "claim, or until_counterexample"
            )
        if self.until_counterexample and ordered and self.clip is None:
            raise ValueError(f"clip: required by {where} with until_counterexample: give [low, high]")
        least = fewest_samples(claim, self.delta_of(problem, claim)) if ordered else 1
        if self.max_tests_of(problem) < least:
            raise ValueError(f"max_tests: {where} needs at least {least} samples, not {self.max_tests_of(problem)}")

    def claims_of(self, problem: Problem) -> tuple[Claim, ...]:
        """Return what is claimed of drawn starts, the first claim first; empty for a problem that draws none."""
        if not isinstance(problem, SampleProblem):
            return ()
        return self.claims or (Claim(quantity="failure_probability"),)

    def delta_of(self, problem: Problem, claim: Claim) -> float:
        """Return the failure probability of one claim about drawn starts."""
        if claim.quantity in UP_TO_CHANCE and claim.level is not None:
            return claim.level
        parts = len(self.claims_of(problem)) if isinstance(problem, SampleProblem) and problem.jointly else 1
        return claim.delta or problem.delta / parts

    def sense_of(self, problem: Problem) -> Sense:
        """Return whether a problem bounds a minimum from below or a maximum from above."""
        for claim in self.claims_of(problem)[:1]:
            return "min" if SAMPLED[claim.quantity].sense == ">=" else "max"
        return OBJECTIVES[problem.name].sense

    def gap_of(self, problem: Problem) -> Gap | None:
        """Return the gap of one problem; None for one that compares no trajectories."""
        return problem.gap or self.gap if OBJECTIVES[problem.name].measured == "gap" else None

    def window_of(self, problem: Problem) -> int:
        """Return the tests in flight of one problem."""
        return problem.window or self.window

    def replicates_of(self, problem: Problem) -> int:
        """Return the rollouts per test and variant of one problem."""
        return problem.replicates or self.replicates

    def resolution_of(self, problem: Problem) -> int:
        """Return the lattice nodes per parameter of one problem."""
        return problem.resolution or self.resolution

    def max_tests_of(self, problem: Problem) -> int:
        """Return the budget of one problem."""
        return problem.max_tests or self.max_tests

    @property
    def digest(self) -> str:
        """Identity of the campaign since rules 2: its keys that differ from their defaults and decide a number."""
        changed = self.model_dump(mode="json", exclude_defaults=True, exclude=DECIDES_NOTHING)
        return digest(merged(changed, self.model_dump(mode="json", include=IDENTIFIES_ALWAYS)))
