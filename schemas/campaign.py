"""The campaign file: every key, its unit, its range and its meaning."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .base import Model, digest, merged
from .kernel import MaternKernel, Positive, Weighted
from .method_spaces import check_space
from .problems import CLAIMS, OBJECTIVES, OF_ROBUSTNESS, MethodName, ProblemName, Sense, any_of
from .space import Space, SystemChoice

Rule = Literal["product", "sum", "bhatia-davis", "pointwise", "single"]

MAX_NU = 40

DECIDES_NOTHING = {"visual", "max_attempts", "hung_after", "deadline", "platform", "second_opinion"}
"""Keys that change no number of a campaign, and so neither its identity nor its seeds."""
IDENTIFIES_ALWAYS: Any = {
    "seed": True,
    "composition": True,
    "problems": {"__all__": {"delta": True, "kernel": {"nu": True}}},
}
"""Keys that are part of the identity also at their default: a file that leaves one out is the same campaign as one that
writes it, and files from before these keys had a default keep their identity."""


class Gap(Model):
    """Comparison of nominal and true trajectory."""

    kind: Literal["signal_sup", "predicate_sup", "robustness"] = Field(
        default="signal_sup",
        description="`signal_sup`: largest difference over time in one column; `predicate_sup`: in any predicate of "
        "the specification; `robustness`: robustness of the nominal minus that of the true trajectory",
    )
    column: str | None = Field(default=None, description="`signal_sup` only, required: a column of the trajectory")
    lipschitz: float = Field(
        default=1.0,
        gt=0,
        description="L: robustness changes by at most L times the gap; must be 1 except for `signal_sup`",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "Gap":
        if (self.column is None) == (self.kind == "signal_sup"):
            needed = "required by" if self.kind == "signal_sup" else "not allowed for"
            raise ValueError(f"column: {needed} kind {self.kind!r}")
        if self.kind != "signal_sup" and self.lipschitz != 1:
            raise ValueError(f"lipschitz: {self.lipschitz:g} must be 1, or be left out, for kind {self.kind!r}")
        return self


class Linearised(Model):
    """E rho - r sd(rho) >= E[X], X = rho - (r/2) ((rho - centre)^2 / spread + spread)."""

    centre: float = Field(description="choose about the mean robustness at the worst start")
    spread: float = Field(
        gt=0, description="choose about the standard deviation there; a larger one loses less by rare falls"
    )


class _Problem(Model):
    """The keys of every optimisation problem."""

    name: ProblemName = Field(description="which objective")
    sense: Sense | None = Field(default=None, description="follows from the name; may be left out")
    column: str | None = Field(
        default=None, description="`maximum` only, required: the column whose expected peak is maximised"
    )
    delta: float = Field(default=0.05, gt=0, lt=1, description="failure probability of the confidence band")
    alpha: float = Field(gt=0, description="tolerance at which the problem stops; unit of the objective")
    window: int | None = Field(default=None, ge=1, le=10_000, description="overrides the campaign's")
    replicates: int | None = Field(default=None, ge=1, le=100_000, description="overrides the campaign's")
    resolution: int | None = Field(default=None, ge=2, description="overrides the campaign's")
    max_tests: int | None = Field(default=None, ge=1, le=1_000_000, description="overrides the campaign's")
    gap: Gap | None = Field(default=None, description="overrides the campaign's")

    @model_validator(mode="after")
    def _consistent(self) -> "_Problem":
        sense, of_column = OBJECTIVES[self.name].sense, OBJECTIVES[self.name].measured == "column"
        if self.sense not in (None, sense):
            raise ValueError(f"sense: {self.sense!r} must be {sense!r} for {self.name}, or be left out")
        if self.column is not None and not of_column:
            raise ValueError(f"column: only problem 'maximum' has one, not {self.name!r}")
        if self.column is None and of_column:
            raise ValueError("column: required by problem 'maximum': the column whose expectation is maximised")
        return self


class _KernelProblem(_Problem):
    """The keys of methods with a Gaussian process."""

    rkhs_norm: float = Field(gt=0, description="B: bound on the norm of J - m0 in the space of the kernel")
    prior_mean: float = Field(
        default=0.0, description="m0: the Gaussian process models J - m0; J is the maximised objective"
    )
    kernel: MaternKernel = Field(description="Matern kernel of unit amplitude; B sets the scale")


class PaperProblem(_KernelProblem):
    """Algorithm 1 of the paper, as printed."""

    method: Literal["paper"] = Field(description="Algorithm 1 as printed")
    c: float = Field(gt=0, description="margin for the noise of the last observation; unit of the objective")
    noise_scale: float = Field(
        ge=0,
        description="R: sub-Gaussian scale of the noise of one rollout; for `true_risk`, of one observation",
    )
    regulariser: Literal["1+eta"] | Positive = Field(
        default="1+eta", description="lambda, added to the diagonal of K; eta = 2/i"
    )
    sigma: Literal["variance", "std"] = Field(
        default="variance", description="reading of sigma: posterior variance or standard deviation"
    )
    tail: Literal["gaussian", "sub-gaussian"] = Field(
        default="gaussian", description="tail of the noise in the probability Delta"
    )
    refine: bool = Field(default=False, description="search around the best node as well, to 1/16 of a cell")

    @model_validator(mode="after")
    def _noisy(self) -> "PaperProblem":
        if self.refine and self.kernel.nu > MAX_NU:
            raise ValueError(f"kernel.nu: {self.kernel.nu:g} must be at most {MAX_NU} with refine = true")
        if self.noise_scale == 0:
            raise ValueError("noise_scale: 0 has no meaning in method 'paper': allowed is a number > 0")
        return self


class RigorousProblem(_KernelProblem):
    """An anytime bound from one confidence set."""

    method: Literal["rigorous"] = Field(description="bounds that are valid at any time; may be left out on a box")
    noise_scale: Literal["derived"] | Annotated[float, Field(ge=0)] = Field(
        description="R: sub-Gaussian scale of the noise of one rollout; `derived`: from the clip (Hoeffding); 0: none"
    )
    regulariser: Annotated[float, Field(ge=1e-9)] | tuple[Weighted, ...] | None = Field(
        default=None, description="lambda, or a mixture of several; by default four values from R and B"
    )
    misspecification: float = Field(
        default=0.0, ge=0, description="tau: largest difference between J - m0 and a function of norm B"
    )
    round_off: float = Field(default=1e-9, gt=0, description="tau0: round-off of a simulator without noise")
    slack: float | None = Field(
        default=None, gt=0, description="tolerance of the maximum over a box; at most alpha, default alpha/4"
    )
    linearised: Linearised | None = Field(
        default=None, description="`true_risk` only, required: constants of an expectation that bounds the risk"
    )

    @model_validator(mode="after")
    def _rigorous(self) -> "RigorousProblem":
        if (self.linearised is None) == OBJECTIVES[self.name].risk:
            raise ValueError("linearised: required by problem 'true_risk' with method 'rigorous', and only there")
        if isinstance(self.regulariser, tuple) and sum(each.weight for each in self.regulariser) > 1 + 1e-12:
            raise ValueError("regulariser: the weights must sum to at most 1")
        if self.kernel.nu > MAX_NU:
            raise ValueError(f"kernel.nu: {self.kernel.nu:g} must be at most {MAX_NU} in method 'rigorous'")
        if self.noise_scale == "derived" and OBJECTIVES[self.name].measured == "column":
            raise ValueError("noise_scale: 'derived' needs a clipped objective, which 'maximum' has not: give a number")
        if self.slack is not None and self.slack > self.alpha:
            raise ValueError(f"slack: {self.slack:g} must be at most alpha = {self.alpha:g}")
        return self


class ScenarioProblem(_Problem):
    """Betting bounds on finitely many starts, without a kernel."""

    delta: float = Field(default=0.05, gt=0, lt=1, description="failure probability of the bound")
    method: Literal["scenario"] = Field(
        description="finitely many starts, no kernel; may be left out on a list of scenarios"
    )
    linearised: Linearised | None = Field(
        default=None,
        description="`true_risk` only: constants of an expectation that bounds the risk; without them, Bhatia-Davis",
    )

    @model_validator(mode="after")
    def _direct(self) -> "ScenarioProblem":
        allowed = tuple(name for name, each in OBJECTIVES.items() if "scenario" in each.methods)
        if self.name not in allowed:
            raise ValueError(f"name: method 'scenario' bounds {any_of(allowed)}, not {self.name!r}")
        if self.linearised is not None and not OBJECTIVES[self.name].risk:
            raise ValueError(f"linearised: only problem 'true_risk' has it, not {self.name!r}; remove this key")
        return self


Problem = PaperProblem | RigorousProblem | ScenarioProblem
PROBLEM_MODELS: dict[MethodName, type[_Problem]] = {
    "paper": PaperProblem,
    "rigorous": RigorousProblem,
    "scenario": ScenarioProblem,
}


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
