"""The keys of a problem in a campaign file, by method: unit, range and meaning of each."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from ..base import Model, key_if_given
from .objectives import OBJECTIVES, MethodName, ProblemName, Sense, any_of

# The kernel and the regulariser of a problem in the campaign file

Positive = Annotated[float, Field(gt=0)]


class MaternKernel(Model):
    """Matern kernel of unit amplitude."""

    nu: float = Field(
        default=2.5, gt=0, le=50, description="smoothness; at most 40 in method `rigorous` and with `refine = true`"
    )
    length_scale: Positive | Annotated[dict[str, Positive], Field(min_length=1)] = Field(
        description="distance over which the objective changes, of all parameters, or of each by name in its unit; "
        "by default half of each range, or the whole range with more than three parameters"
    )

    @property
    def described(self) -> float | str:
        """The length scale as one value of an assumption: the number, or the numbers with their parameters."""
        if not isinstance(self.length_scale, dict):
            return self.length_scale
        # By name: a file and its copy in the database may list them in different orders.
        return ", ".join(f"{length:g} ({name})" for name, length in sorted(self.length_scale.items()))

    def scaled(self, factor: float) -> "MaternKernel":
        """Return the kernel with every length scale multiplied."""
        lengths = self.length_scale
        changed = (
            {name: factor * length for name, length in lengths.items()}
            if isinstance(lengths, dict)
            else factor * lengths
        )
        return self.model_copy(update={"length_scale": changed})


class Weighted(Model):
    """One regulariser of a mixture that is fixed beforehand."""

    value: float = Field(ge=1e-9, description="lambda")
    weight: float = Field(gt=0, le=1, description="the weights sum to at most 1")


MAX_NU = 40
OVERRIDES = "instead of the campaign's"
"""The meaning of a key of a problem that the top level has as well."""


class Gap(Model):
    """Comparison of nominal and true trajectory."""

    kind: Literal["signal_sup", "predicate_sup", "robustness"] = Field(
        default="signal_sup",
        description="largest difference over time in one column, or in any predicate of the specification; or "
        "robustness, nominal minus true",
    )
    column: str | None = Field(default=None, description="of `signal_sup`, required: a column of the trajectory")
    lipschitz: float = Field(
        default=1.0,
        gt=0,
        description="L: robustness changes by at most L times the gap; 1 except for `signal_sup`",
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
    """The keys of every problem."""

    bound_at_end: ClassVar[bool] = False
    """Whether a bound is claimed for the test alone at which the problem ends."""

    name: ProblemName = Field(description="which objective")
    sense: Sense | None = Field(default=None, description="follows from the name")
    column: str | None = Field(
        default=None, description="of `maximum`, required: the column whose expected peak is maximised"
    )
    delta: float = Field(
        default=0.05, gt=0, lt=1, description="failure probability of the bound, or of each drawn claim"
    )
    window: int | None = Field(default=None, ge=1, le=10_000, description=OVERRIDES)
    replicates: int | None = Field(default=None, ge=1, le=100_000, description=OVERRIDES)
    resolution: int | None = Field(default=None, ge=2, description=OVERRIDES)
    max_tests: int | None = Field(default=None, ge=1, le=1_000_000, description=OVERRIDES)
    gap: Gap | None = Field(default=None, description=OVERRIDES)

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

    @property
    def observed_through(self) -> Linearised | None:
        """The constants of the expectation that an observation is of; None where it is of the robustness itself."""
        return None


class _OptimisedProblem(_Problem):
    """The keys of methods that search the worst start."""

    alpha: float = Field(gt=0, description="tolerance at which the problem stops, in the unit of the objective")


class _PlannedProblem(_Problem):
    """The keys of methods whose number of tests is fixed beforehand."""

    @property
    def alpha(self) -> None:
        """None: no tolerance ends the tests."""
        return None


class _BallProblem(_Problem):
    """The keys of methods that assume a norm in the space of a kernel."""

    rkhs_norm: float = Field(gt=0, description="B: bound on the norm of J - m0 in the space of the kernel")
    prior_mean: float = Field(default=0.0, description="m0: J - m0 is modelled, J being the maximised objective")
    kernel: MaternKernel = Field(description="Matern kernel of unit amplitude")


class _KernelProblem(_BallProblem, _OptimisedProblem):
    """The keys of methods with a Gaussian process."""


class PaperProblem(_KernelProblem):
    """Algorithm 1 of the paper, as printed."""

    bound_at_end: ClassVar[bool] = True
    method: Literal["paper"] = Field(description="Algorithm 1 as printed")
    c: float = Field(gt=0, description="margin for the noise of the last observation")
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
    refine: bool = Field(default=False, description="search around the best node, to 1/16 of a cell")

    @model_validator(mode="after")
    def _noisy(self) -> "PaperProblem":
        if self.refine and self.kernel.nu > MAX_NU:
            raise ValueError(f"kernel.nu: {self.kernel.nu:g} must be at most {MAX_NU} with refine = true")
        if self.noise_scale == 0:
            raise ValueError("noise_scale: 0 has no meaning in method 'paper': allowed is a number > 0")
        return self


class RigorousProblem(_KernelProblem):
    """An anytime bound from one confidence set."""

    method: Literal["rigorous"] = Field(description="bounds that are valid at any time")
    noise_scale: Literal["derived"] | Annotated[float, Field(ge=0)] = Field(
        description="R: sub-Gaussian scale of the noise of one rollout; `derived` from the clip (Hoeffding); 0 for none"
    )
    regulariser: Annotated[float, Field(ge=1e-9)] | tuple[Weighted, ...] | None = Field(
        default=None, description="lambda, or a mixture of several; by default four values from R and B"
    )
    misspecification: float = Field(
        default=0.0, ge=0, description="tau: largest difference between J - m0 and a function of norm B"
    )
    round_off: float = Field(default=1e-9, gt=0, description="tau0: round-off of a simulator without noise")
    slack: float | None = Field(
        default=None, gt=0, description="tolerance of the maximum over a box; by default alpha/4, at most alpha"
    )
    linearised: Linearised | None = Field(
        default=None, description="of `true_risk`, required: constants of an expectation that bounds the risk"
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

    @property
    def observed_through(self) -> Linearised | None:
        """The constants of `linearised`."""
        return self.linearised


class KrigingProblem(_BallProblem, _PlannedProblem):
    """A bound over a box from weighted sums of rollouts, at starts that follow from the budget."""

    bound_at_end: ClassVar[bool] = True
    method: Literal["kriging"] = Field(description="weighted sums of bounded rollouts on a box")
    linearised: Linearised | None = Field(
        default=None, description="of `true_risk`, required: constants of an expectation that bounds the risk"
    )
    spread: Positive | None = Field(
        default=None,
        description="guess of the standard deviation of one value; a wrong one costs tightness, never validity; by "
        "default that of `linearised`, or a tenth of the range",
    )
    points: int | None = Field(
        default=None,
        ge=2,
        le=9,
        description="starts per parameter, more along one with a short length scale and fewer along others; by default "
        "5 at most, fewer for a small budget; not with more than 3 parameters, whose starts are scattered",
    )

    @model_validator(mode="after")
    def _weighted(self) -> "KrigingProblem":
        allowed = tuple(name for name, each in OBJECTIVES.items() if "kriging" in each.methods)
        if self.name not in allowed:
            raise ValueError(f"name: method 'kriging' bounds {any_of(allowed)}, not {self.name!r}")
        if (self.linearised is None) == OBJECTIVES[self.name].risk:
            raise ValueError("linearised: required by problem 'true_risk' with method 'kriging', and only there")
        if self.window is not None:
            raise ValueError("window: has no meaning in method 'kriging', which plans every start; remove this key")
        if self.kernel.nu > MAX_NU:
            raise ValueError(f"kernel.nu: {self.kernel.nu:g} must be at most {MAX_NU} in method 'kriging'")
        return self

    @property
    def observed_through(self) -> Linearised | None:
        """The constants of `linearised`."""
        return self.linearised


class ScenarioProblem(_OptimisedProblem):
    """Betting bounds on finitely many starts, without a kernel."""

    method: Literal["scenario"] = Field(description="finitely many starts, no kernel")
    linearised: Linearised | Literal["past"] | None = Field(
        default=None,
        description="of `true_risk`: constants of an expectation that bounds the risk, or `past`, from the earlier "
        "rollouts of each start; without this key, Bhatia-Davis",
    )

    @model_validator(mode="after")
    def _direct(self) -> "ScenarioProblem":
        allowed = tuple(name for name, each in OBJECTIVES.items() if "scenario" in each.methods)
        if self.name not in allowed:
            raise ValueError(f"name: method 'scenario' bounds {any_of(allowed)}, not {self.name!r}")
        if self.linearised is not None and not OBJECTIVES[self.name].risk:
            raise ValueError(f"linearised: only problem 'true_risk' has it, not {self.name!r}; remove this key")
        return self


class SampleProblem(_PlannedProblem):
    """Bounds from starts that are drawn, without a kernel and in any dimension."""

    method: Literal["sample"] = Field(description="starts drawn from the distribution under [space]")
    jointly: bool = Field(
        default=False,
        description="all claims together fail with probability `delta`, of which each gets an equal part",
    )

    @model_validator(mode="after")
    def _sampled(self) -> "SampleProblem":
        if "sample" not in OBJECTIVES[self.name].methods:
            allowed = tuple(name for name, each in OBJECTIVES.items() if "sample" in each.methods)
            raise ValueError(f"name: method 'sample' is for {any_of(allowed)}, not {self.name!r}")
        for key in WITHOUT_MEANING:
            if getattr(self, key) is not None:
                raise ValueError(f"{key}: has no meaning in method 'sample'; remove this key")
        return self


WITHOUT_MEANING = ("sense", "resolution", "window", "gap")
"""Keys of every problem that method `sample` refuses: nothing is optimised, and no start depends on a rollout."""

Problem = PaperProblem | RigorousProblem | KrigingProblem | ScenarioProblem | SampleProblem
KernelProblem = PaperProblem | RigorousProblem | KrigingProblem
"""The problems whose bound owes something to a norm in the space of a kernel."""
PROBLEM_MODELS: dict[MethodName, type[_Problem]] = {
    "paper": PaperProblem,
    "rigorous": RigorousProblem,
    "kriging": KrigingProblem,
    "scenario": ScenarioProblem,
    "sample": SampleProblem,
}

# The search for a counterexample


MOST_CLUSTERS = 20
"""Clusters of failing starts that end a search, and whose failures are simplified."""


class Falsify(Model):
    """Where tests come from while a start is sought at which the system fails; an empty table takes every default."""

    until: str = Field(
        default="counterexample",
        pattern=r"^(counterexample|budget|([2-9]|1[0-9]|20) clusters)$",
        exclude_if=lambda until: until == "counterexample",
        description='where the search ends: with the first failing test, with so many clusters of failing starts (`"3 '
        'clusters"`, 2 to 20) or `max_tests`, or with `max_tests` alone (`"budget"`)',
    )
    over: Literal["starts", "disturbances"] = Field(
        default="starts",
        exclude_if=lambda over: over == "starts",
        description="what is chosen: starts, or starts and the declared disturbances together; with method `sample`",
    )
    likeliest_tests: int = Field(
        default=100,
        ge=0,
        le=1000,
        exclude_if=lambda tests: tests == 100,
        description='with `over = "disturbances"`: most rollouts after the counterexample, towards the likeliest '
        "disturbances with which the system fails; no claim uses them",
    )
    importance_tests: int = Field(
        default=200,
        ge=0,
        le=100_000,
        exclude_if=lambda tests: tests == 200,
        description="rollouts around the likeliest failure, from which a lower bound of the probability of a failure "
        "at its start follows",
    )
    random_every: int = Field(
        default=4,
        ge=1,
        le=1000,
        description="of so many tests one is at random; with method `sample` only these are samples, and the others "
        "enter no claim",
    )

    scale: dict[str, Annotated[float, Field(gt=0)]] | None = key_if_given(
        "what the robustness of each predicate is divided by in the search alone, by its column: its usual range; of "
        "several columns the largest",
        min_length=1,
    )
    shrink: bool = Field(
        default=False,
        exclude_if=lambda shrink: not shrink,
        description="move the counterexample towards `nominal` by bisection, as long as the system fails there",
    )
    nominal: dict[str, float] = Field(
        default={},
        exclude_if=lambda nominal: not nominal,
        description="nominal values of some parameters; by default the middle of each range",
    )
    shrink_tests: int = Field(
        default=20,
        ge=1,
        le=1000,
        exclude_if=lambda tests: tests == 20,
        description="most rollouts for it; no claim uses them",
    )
    simplest_tests: int = Field(
        default=50,
        ge=0,
        le=1000,
        exclude_if=lambda tests: tests == 50,
        description="on ranges: most rollouts for each failure, which set as many parameters as possible to their "
        "nominal value while it still fails alike; no claim uses them",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "Falsify":
        if self.nominal and not (self.shrink or self.simplifying_tests):
            raise ValueError("nominal: `shrink` and `simplest_tests` go there; add one of them, or remove this key")
        if self.shrink and self.over == "disturbances":
            raise ValueError(
                'shrink: not together with over = "disturbances", after which the likeliest failure is sought; remove '
                "this key"
            )
        if self.until != "counterexample" and (self.shrink or self.over == "disturbances"):
            key = "shrink" if self.shrink else "over"
            raise ValueError(f"{key}: follows the one counterexample that ends a search; remove this key, or `until`")
        return self

    @property
    def clusters(self) -> int | None:
        """How many clusters of failing starts end the search; None where they do not."""
        return int(self.until.removesuffix(" clusters")) if self.until.endswith(" clusters") else None

    @property
    def improving_tests(self) -> int:
        """Most rollouts that look for a better counterexample."""
        return self.likeliest_tests if self.over == "disturbances" else self.shrink_tests

    @property
    def simplifying_tests(self) -> int:
        """Most rollouts that look for the simplest failure; 0 of a search over disturbances: it has the likeliest."""
        return 0 if self.over == "disturbances" else self.simplest_tests

    @property
    def most_simplifying_tests(self) -> int:
        """Most such rollouts for all failures together."""
        failures = 1 if self.until == "counterexample" else self.clusters or MOST_CLUSTERS
        return self.simplifying_tests * failures

    @property
    def sampled_tests(self) -> int:
        """Rollouts around the likeliest failure; 0 of a search over starts, which seeks none."""
        return self.importance_tests if self.over == "disturbances" else 0

    def is_random(self, test: int) -> bool:
        """Whether no outcome chooses the start of test `test`: the last of each `random_every`."""
        return (test + 1) % self.random_every == 0

    def random(self, tests: int) -> int:
        """Return for how many of the first tests `is_random` holds."""
        return tests // self.random_every

    def random_test(self, number: int) -> int:
        """Return the test that is the one with this number, from 0 on, of those for which `is_random` holds."""
        return (number + 1) * self.random_every - 1
