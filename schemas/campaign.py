"""The campaign file: every key, its unit, its range and its meaning."""

import difflib
import json
import tomllib
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from schemas.base import Model, digest
from schemas.system import OptionValue, SystemSpec, Variant

ProblemName = Literal["nominal_robustness", "sim_gap", "true_risk", "maximum"]
Sense = Literal["min", "max"]
Positive = Annotated[float, Field(gt=0)]

MAX_CANDIDATES = 100_000
"""Nodes of the largest lattice; memory is O(tests x nodes)."""

SENSES: dict[ProblemName, Sense] = {
    "nominal_robustness": "min",
    "sim_gap": "max",
    "true_risk": "min",
    "maximum": "max",
}
ROLLED_OUT: dict[ProblemName, tuple[Variant, ...]] = {
    "nominal_robustness": ("nominal",),
    "sim_gap": ("nominal", "true"),
    "true_risk": ("true",),
    "maximum": ("true",),
}


class CampaignError(ValueError):
    """A campaign file that cannot be run; the text names the file, the key and what is allowed."""


class SystemChoice(Model, extra="allow"):
    """The system under test and its options, as its SystemSpec lists them."""

    __pydantic_extra__: dict[str, OptionValue] = Field(init=False)
    name: str = Field(description="an installed system: `perfbound systems` lists them")

    @property
    def options(self) -> dict[str, OptionValue]:
        """The options that the file sets."""
        return dict(self.__pydantic_extra__ or {})


class Range(Model):
    """All values of one parameter of the starting condition d."""

    low: float
    high: float
    unit: str = ""

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if not self.low < self.high:
            raise ValueError(f"low = {self.low:g} must be less than high = {self.high:g}")
        return self


class MaternKernel(Model):
    """Matern kernel of unit amplitude."""

    nu: float = Field(gt=0, le=50, description="smoothness")
    length_scale: float = Field(gt=0, description="unit of the parameters")


class Gap(Model):
    """How nominal and true trajectory are compared: sup_t |column_true(t) - column_nominal(t)|."""

    kind: Literal["signal_sup"] = "signal_sup"
    column: str
    lipschitz: float = Field(default=1.0, gt=0, description="L: robustness changes by at most L times the gap")


class Problem(Model):
    """One optimisation problem: what is bounded, by which method, how sure."""

    name: ProblemName
    method: Literal["paper"] = Field(default="paper", description="paper: Algorithm 1 as printed")
    sense: Sense | None = Field(default=None, description="min or max; follows from the name")
    column: str | None = Field(default=None, description="`maximum` only: the column whose expectation is maximised")
    delta: float = Field(gt=0, lt=1, description="failure probability of the confidence band")
    alpha: float = Field(gt=0, description="tolerance; unit of the objective")
    c: float = Field(gt=0, description="margin for the noise of the last observation; unit of the objective")
    rkhs_norm: float = Field(gt=0, description="B: bound on the norm of the centred objective")
    noise_scale: float = Field(
        ge=0,
        description="R: sub-Gaussian noise of one rollout; of one observation for true_risk, which is not a mean",
    )
    prior_mean: float = Field(default=0.0, description="m0: the GP models J - m0, J the maximised objective")
    kernel: MaternKernel
    regulariser: Literal["1+eta"] | Positive = Field(default="1+eta", description="lambda on the diagonal of K")
    sigma: Literal["variance", "std"] = Field(default="variance", description="how eq. (GP_sigma) is read")
    tail: Literal["gaussian", "sub-gaussian"] = Field(default="gaussian", description="tail of the noise in Delta")
    window: int | None = Field(default=None, ge=1, description="overrides the campaign's")
    replicates: int | None = Field(default=None, ge=1, le=100_000, description="overrides the campaign's")
    resolution: int | None = Field(default=None, ge=2, description="overrides the campaign's")
    max_tests: int | None = Field(default=None, ge=1, description="overrides the campaign's")
    gap: Gap | None = Field(default=None, description="overrides the campaign's")

    @model_validator(mode="after")
    def _consistent(self) -> "Problem":
        if self.sense not in (None, SENSES[self.name]):
            raise ValueError(f"sense = {self.sense!r} must be {SENSES[self.name]!r} for {self.name}")
        if self.method == "paper" and self.noise_scale == 0:
            raise ValueError("noise_scale = 0 has no meaning in method 'paper': allowed are numbers > 0")
        if (self.column is not None) != (self.name == "maximum"):
            raise ValueError(f"column is for problem 'maximum' and required there; this is {self.name!r}")
        return self


class CampaignConfig(Model):
    """A whole campaign file."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$", description="names the run directory")
    seed: int = Field(ge=0, lt=2**53)
    window: int = Field(default=1, ge=1, le=10_000, description="tests in flight per problem")
    replicates: int = Field(default=1, ge=1, le=100_000, description="rollouts per test and variant")
    resolution: int = Field(default=21, ge=2, description="lattice nodes per parameter")
    max_tests: int = Field(default=2000, ge=1, le=1_000_000, description="budget per problem")
    horizon: float = Field(default=0.0, ge=0, description="length of a rollout in s; 0 for a function")
    risk_weight: float = Field(default=0.2, gt=0, description="r of rho* = min E - r sd")
    clip: tuple[float, float] | None = Field(default=None, description="[-m, M]: robustness is clipped to it")
    specification: str | None = Field(default=None, max_length=10_000, description="STL formula over the columns")
    gap: Gap | None = None
    composition: Literal["product", "sum", "single"] = Field(
        description="how the claim follows: Theorem 2 with the product or the sum rule, or one problem alone"
    )
    visual: Literal["all", "none"] = Field(default="all", description="what is drawn for people in each trajectory file")
    max_attempts: int = Field(default=5, ge=1, le=1000, description="failed attempts of a rollout that end the campaign")
    hung_after: float = Field(default=10.0, ge=1, description="s without progress after which a worker is given up")
    deadline: float = Field(default=600.0, ge=1, description="s that one attempt may last")
    system: SystemChoice
    space: dict[str, Range] = Field(min_length=1)
    problems: tuple[Problem, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> "CampaignConfig":
        names = [problem.name for problem in self.problems]
        for repeated in {name for name in names if names.count(name) > 1}:
            raise ValueError(f"problems: {repeated!r} stands twice; every problem at most once")
        if self.clip is not None and not self.clip[0] < self.clip[1]:
            raise ValueError(f"clip: {list(self.clip)} must be [low, high] with low < high")
        for problem in self.problems:
            self._check_problem(problem)
        self._check_composition(set(names))
        return self

    def _check_problem(self, problem: Problem) -> None:
        where = f"problems.{problem.name}"
        if problem.name != "maximum":
            for key in ("specification", "clip"):
                if getattr(self, key) is None:
                    raise ValueError(f"{key}: required by problem {problem.name!r}")
            if self.horizon == 0:
                raise ValueError(f"horizon: problem {problem.name!r} needs a rollout longer than 0 s")
        if problem.name == "sim_gap" and self.gap_of(problem) is None:
            raise ValueError("gap: required by problem 'sim_gap', e.g. { kind = \"signal_sup\", column = \"phi\" }")
        if problem.name == "true_risk" and self.replicates_of(problem) < 2:
            raise ValueError(f"{where}.replicates: a standard deviation needs at least 2 rollouts a test")
        if problem.method == "paper" and self.window_of(problem) != 1:
            raise ValueError(f"{where}.window: Algorithm 1 is sequential, method 'paper' allows 1 only")
        nodes = self.resolution_of(problem) ** len(self.space)
        if nodes > MAX_CANDIDATES:
            raise ValueError(f"{where}.resolution: {nodes} lattice nodes are more than the {MAX_CANDIDATES} allowed")

    def _check_composition(self, names: set[str]) -> None:
        if self.composition == "single" and len(names) != 1:
            raise ValueError("composition: 'single' is for one problem; allowed here: 'product', 'sum'")
        if self.composition != "single" and not {"nominal_robustness", "sim_gap"} <= names:
            raise ValueError(
                f"composition: {self.composition!r} needs the problems 'nominal_robustness' and 'sim_gap'"
            )
        if self.composition == "single" and names & {"nominal_robustness", "sim_gap"}:
            raise ValueError("composition: 'single' makes a claim of 'true_risk' or 'maximum' only")

    def gap_of(self, problem: Problem) -> Gap | None:
        """The gap of one problem."""
        return problem.gap or self.gap

    def window_of(self, problem: Problem) -> int:
        """Tests in flight of one problem."""
        return problem.window or self.window

    def replicates_of(self, problem: Problem) -> int:
        """Rollouts per test and variant of one problem."""
        return problem.replicates or self.replicates

    def resolution_of(self, problem: Problem) -> int:
        """Lattice nodes per parameter of one problem."""
        return problem.resolution or self.resolution

    def max_tests_of(self, problem: Problem) -> int:
        """Budget of one problem."""
        return problem.max_tests or self.max_tests

    @property
    def digest(self) -> str:
        """Identity of the campaign, whatever the layout of its file."""
        return digest(self.model_dump(mode="json"))


def parse(data: bytes, source: str, **overrides: Any) -> CampaignConfig:
    """Read the bytes of a campaign file; `overrides` replace top-level keys.

    Raises:
        CampaignError: one line with the file, the key and the allowed values.

    """
    try:
        table = tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise CampaignError(f"{source}: not UTF-8 (byte {error.start}); save the file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise CampaignError(f"{source}: not TOML: {error}") from None
    if not table:
        raise CampaignError(f"{source}: the file is empty; see deploy/campaigns for examples")
    try:
        text = json.dumps({**table, **overrides}, allow_nan=True, default=_refuse_date)
        return CampaignConfig.model_validate_json(text)
    except ValidationError as error:
        raise CampaignError(f"{source}: {explain(error)}") from None


def explain(error: ValidationError) -> str:
    """Return the first fault in one line: key, value, what is allowed; and how many more there are."""
    faults = error.errors(include_url=False)
    first = faults[0]
    key = ".".join(str(part) for part in first["loc"] if part not in ("constrained-float", "literal['1+eta']"))
    text = _describe(first, key)
    more = len({str(fault["loc"][:3]) for fault in faults}) - 1
    return text if more == 0 else f"{text} (and {more} more)"


def _describe(fault: Any, key: str) -> str:
    kind, message = fault["type"], str(fault["msg"])
    if kind == "extra_forbidden":
        allowed = _keys_at(fault["loc"][:-1])
        near = difflib.get_close_matches(str(fault["loc"][-1]), allowed, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return f"{key}: unknown key; {hint}allowed are {', '.join(sorted(allowed))}"
    if kind == "missing":
        return f"{key}: this key is required"
    if kind == "value_error":
        reason = message.removeprefix("Value error, ")
        return f"{key}: {reason}" if key else reason
    if kind == "json_invalid":
        return f"not a value that JSON can hold: {message}"
    value = fault.get("input")
    shown = repr(value)[:80] if not isinstance(value, dict) else "a table"
    return f"{key}: {shown} is not allowed: {message[:1].lower()}{message[1:]}"


def _keys_at(location: tuple[int | str, ...]) -> list[str]:
    model: Any = CampaignConfig
    for part in location:
        if part == "problems":
            model = Problem
        elif part == "kernel":
            model = MaternKernel
        elif part == "gap":
            model = Gap
        elif part == "space":
            model = Range
    return list(model.model_fields)


def _refuse_date(value: object) -> str:
    return f"<{type(value).__name__}>"


def check_against(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Check what only the system under test can decide: parameters, columns, options, horizon.

    Raises:
        CampaignError: one line with the file, the key and the allowed values.

    """
    for fault in _faults(config, spec):
        raise CampaignError(f"{source}: {fault}")


def _faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    return [*_space_faults(config, spec), *_option_faults(config, spec), *_rollout_faults(config, spec)]


def _space_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    known = {parameter.name: parameter for parameter in spec.parameters}
    faults = [f"space.{name}: unknown parameter; {spec.name} has {', '.join(known)}" for name in config.space.keys() - known]
    faults += [f"space.{name}: this parameter of {spec.name} is required" for name in known if name not in config.space]
    for name, box in config.space.items():
        parameter = known.get(name)
        if parameter is None:
            continue
        if not parameter.low <= box.low <= box.high <= parameter.high:
            faults.append(
                f"space.{name}: [{box.low:g}, {box.high:g}] leaves [{parameter.low:g}, {parameter.high:g}] "
                f"{parameter.unit}, the range of {spec.name}"
            )
        if box.unit not in ("", parameter.unit):
            faults.append(f"space.{name}.unit: {box.unit!r} is not allowed: {spec.name} takes {parameter.unit!r}")
    return faults


def _option_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    known = {option.name: option for option in spec.options}
    faults = []
    for name, value in config.system.options.items():
        option = known.get(name)
        if option is None:
            allowed = ", ".join(["name", *known])
            faults.append(f"system.{name}: unknown key; allowed for {spec.name} are {allowed}")
        elif option.choices:
            if value not in option.choices:
                faults.append(f"system.{name}: {value!r} is not allowed: choose from {', '.join(option.choices)}")
        elif not isinstance(value, int | float) or not _within(value, option.low, option.high):
            faults.append(
                f"system.{name}: {value!r} is not allowed: a number in [{option.low:g}, {option.high:g}] {option.unit}"
            )
    return faults


def _within(value: float, low: float | None, high: float | None) -> bool:
    return (low is None or low <= value) and (high is None or value <= high)


def _rollout_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    columns = [column.name for column in spec.columns]
    faults = []
    if config.horizon > spec.max_horizon:
        faults.append(f"horizon: {config.horizon:g} s is more than the {spec.max_horizon:g} s of {spec.name}")
    for index, problem in enumerate(config.problems):
        missing = set(ROLLED_OUT[problem.name]) - set(spec.variants)
        if missing:
            faults.append(f"problems.{index}.name: {spec.name} has no variant {', '.join(sorted(missing))}")
        gap = config.gap_of(problem)
        for key, column in (("column", problem.column), ("gap.column", gap.column if gap else None)):
            if column is not None and column not in columns:
                faults.append(f"problems.{index}.{key}: no column {column!r}; {spec.name} has {', '.join(columns)}")
    return faults
