"""The campaign file: every key, its unit, its range and its meaning."""

import difflib
import json
import tomllib
from collections.abc import Iterator
from datetime import date, time
from typing import Annotated, Any, Literal, get_args, get_origin

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


Location = tuple[int | str, ...]
"""Where pydantic found a fault."""

_UNION_MEMBERS = ("constrained-float", "float", "str", "literal['1+eta']")
_LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_WORDS = {
    ("name",): "1 to 64 of a-z, 0-9, '-' and '_', the first a letter or digit",
    ("clip",): "[low, high], two numbers",
    ("space",): "a table with one entry per parameter: name = { low, high, unit }",
    ("problems",): "a list of tables, each under [[problems]]",
    ("problems", "regulariser"): "'1+eta' or a number > 0",
}
"""What a key may hold, where neither the schema nor pydantic says it well."""


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

    low: float = Field(description="least value")
    high: float = Field(description="greatest value")
    unit: str = Field(default="", description="checked against the system's, if given")

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if not self.low < self.high:
            raise ValueError(f"low: {self.low:g} must be less than high = {self.high:g}")
        return self


class MaternKernel(Model):
    """Matern kernel of unit amplitude."""

    nu: float = Field(gt=0, le=50, description="smoothness")
    length_scale: float = Field(gt=0, description="unit of the parameters")


class Gap(Model):
    """How nominal and true trajectory are compared: sup_t |column_true(t) - column_nominal(t)|."""

    kind: Literal["signal_sup"] = Field(default="signal_sup", description="largest difference in one column over time")
    column: str = Field(description="a column of the system")
    lipschitz: float = Field(default=1.0, gt=0, description="L: robustness changes by at most L times the gap")


class Problem(Model):
    """One optimisation problem: what is bounded, by which method, how sure."""

    name: ProblemName = Field(description="which objective")
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
    kernel: MaternKernel = Field(description="Matern kernel of unit amplitude; the amplitude lives in B")
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
            raise ValueError(f"sense: {self.sense!r} must be {SENSES[self.name]!r} for {self.name}, or be left out")
        if self.noise_scale == 0:
            raise ValueError(f"noise_scale: 0 has no meaning in method {self.method!r}: allowed is a number > 0")
        if self.column is not None and self.name != "maximum":
            raise ValueError(f"column: only problem 'maximum' has one, not {self.name!r}")
        if self.column is None and self.name == "maximum":
            raise ValueError("column: required by problem 'maximum': the column whose expectation is maximised")
        return self


class CampaignConfig(Model):
    """A whole campaign file."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$", description="names the run directory")
    seed: int = Field(ge=0, lt=2**53, description="every random choice follows from it; `--seed` overrides it")
    window: int = Field(default=1, ge=1, le=10_000, description="tests in flight per problem")
    replicates: int = Field(default=1, ge=1, le=100_000, description="rollouts per test and variant")
    resolution: int = Field(default=21, ge=2, description="lattice nodes per parameter")
    max_tests: int = Field(default=2000, ge=1, le=1_000_000, description="budget per problem")
    horizon: float = Field(default=0.0, ge=0, description="length of a rollout in s; 0 for a function")
    risk_weight: float = Field(default=0.2, gt=0, description="r of rho* = min E - r sd")
    clip: tuple[float, float] | None = Field(default=None, description="[-m, M]: robustness is clipped to it")
    specification: str | None = Field(default=None, max_length=10_000, description="STL formula over the columns")
    gap: Gap | None = Field(default=None, description="how true and nominal trajectory are compared")
    composition: Literal["product", "sum", "single"] = Field(
        description="how the claim follows: Theorem 2 with the product or the sum rule, or one problem alone"
    )
    visual: Literal["all", "none"] = Field(
        default="all", description="what is drawn for people in each trajectory file"
    )
    max_attempts: int = Field(
        default=5, ge=1, le=1000, description="failed attempts of a rollout that end the campaign"
    )
    hung_after: float = Field(default=10.0, ge=1, description="s without progress after which a worker is given up")
    deadline: float = Field(default=600.0, ge=1, description="s that one attempt may last")
    system: SystemChoice = Field(description="the system under test")
    space: dict[str, Range] = Field(min_length=1, description="D: all starting conditions")
    problems: tuple[Problem, ...] = Field(min_length=1, description="what is bounded")

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
            raise ValueError('gap: required by problem \'sim_gap\', e.g. { kind = "signal_sup", column = "phi" }')
        if problem.name == "true_risk" and self.replicates_of(problem) < 2:
            raise ValueError(f"{where}.replicates: a standard deviation needs at least 2 rollouts a test")
        if self.window_of(problem) != 1:
            raise ValueError(f"{where}.window: Algorithm 1 is sequential, method {problem.method!r} allows 1 only")
        if self.max_tests_of(problem) < 2:
            raise ValueError(f"{where}.max_tests: method {problem.method!r} gives no bound before the second test")
        nodes = self.resolution_of(problem) ** len(self.space)
        if nodes > MAX_CANDIDATES:
            raise ValueError(f"{where}.resolution: {nodes} lattice nodes are more than the {MAX_CANDIDATES} allowed")

    def _check_composition(self, names: set[str]) -> None:
        if self.composition == "single" and len(names) != 1:
            raise ValueError("composition: 'single' is for one problem; allowed here: 'product', 'sum'")
        if self.composition != "single" and not {"nominal_robustness", "sim_gap"} <= names:
            raise ValueError(f"composition: {self.composition!r} needs the problems 'nominal_robustness' and 'sim_gap'")
        if self.composition == "single" and names & {"nominal_robustness", "sim_gap"}:
            raise ValueError("composition: 'single' makes a claim of 'true_risk' or 'maximum' only")

    def gap_of(self, problem: Problem) -> Gap | None:
        """Return the gap of one problem."""
        return problem.gap or self.gap

    def window_of(self, problem: Problem) -> int:
        """Return the tests in flight of one problem."""
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
        table = tomllib.loads(data.decode("utf-8-sig"))
        dates = [f"{key}: {value}" for key, value in _leaves(table, "") if isinstance(value, date | time)]
        text = json.dumps({**table, **overrides}, default=str)
    except UnicodeDecodeError as error:
        raise CampaignError(f"{source}: not UTF-8 (byte {error.start}); save the file as UTF-8") from None
    except (ValueError, RecursionError) as error:  # also integers of thousands of digits, and lists without end
        raise CampaignError(f"{source}: not TOML: {str(error).partition(';')[0]}") from None
    if not table:
        raise CampaignError(f"{source}: the file is empty; see deploy/campaigns for examples")
    if dates:
        raise CampaignError(f"{source}: {dates[0]} is a date or time, which no key takes; put text in quotes")
    try:
        return CampaignConfig.model_validate_json(text)
    except ValidationError as error:
        raise CampaignError(f"{source}: {_explain(error, table)}") from None


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield (key, value) of everything in a TOML value that is neither table nor list."""
    inner: Any = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        yield key, value
        return
    for part, child in inner:
        yield from _leaves(child, f"{key}.{part}" if key else str(part))


def _explain(error: ValidationError, table: dict[str, Any]) -> str:
    """Return the first fault in one line: key, value, what is allowed; and how many more there are."""
    # A misspelt key makes two faults; the one to read is that it is unknown, not that the right one is missing.
    faults = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] != "extra_forbidden")
    text = _describe(faults[0], _key(faults[0]["loc"], table))
    places = {_without_union(fault["loc"]) for fault in faults}
    # A list is "too short" for pydantic if its entries are wrong: that is no fault of its own.
    more = sum(not any(other != place == other[: len(place)] for other in places) for place in places) - 1
    return text if more == 0 else f"{text} (and {more} more)"


def _key(location: Location, table: dict[str, Any]) -> str:
    """Return the dotted key of a fault; a problem goes by its name."""
    parts = [str(part) for part in _without_union(location)]
    if parts and parts[0] == "problems" and len(parts) > 1 and parts[2:] != ["name"]:
        problem = table["problems"][int(parts[1])]
        name = problem.get("name") if isinstance(problem, dict) else None
        parts[1] = name if isinstance(name, str) and name in SENSES else parts[1]
    return ".".join(parts)


def _without_union(location: Location) -> Location:
    """Drop pydantic's name of the member of a union."""
    return location[:-1] if location and location[-1] in _UNION_MEMBERS else location


def _describe(fault: Any, key: str) -> str:
    kind, message, location = fault["type"], str(fault["msg"]), _without_union(fault["loc"])
    if kind == "extra_forbidden":
        allowed = list(_model_at(location[:-1]).model_fields)
        near = difflib.get_close_matches(str(location[-1]), allowed, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return f"{key}: unknown key; {hint}allowed are {', '.join(sorted(allowed))}"
    if kind == "value_error":
        reason = message.removeprefix("Value error, ")
        return f"{key}.{reason}" if key else reason
    if kind == "json_invalid":
        return f"not a value that JSON can hold: {message}"
    allowed_text = _allowed(location) or message.removeprefix("Input should be ").replace("an object", "a table")
    if kind == "missing" and isinstance(location[-1], str):
        what = "" if allowed_text == message else f": {allowed_text}"
        return f"{key}: this key is required{what}"
    value = fault.get("input")
    shown = "a table" if isinstance(value, dict) else repr(value)[:80]
    return f"{key}: {shown} is not allowed: allowed is {allowed_text}"


def _allowed(location: Location) -> str:
    """Return what a key may hold, in words; empty where pydantic says it better."""
    names = tuple(part for part in location if isinstance(part, str))
    if names in _WORDS:
        return _WORDS[names]
    if names[0] == "system" and names[-1] != "name":
        return "text or a number, as the system has it: see `perfbound systems`"
    field = _model_at(location[:-1]).model_fields.get(names[-1])
    if field is not None and get_origin(field.annotation) is Literal:
        return f"one of {', '.join(map(repr, get_args(field.annotation)))}"
    kinds = {field.annotation, *get_args(field.annotation)} if field else set()
    number = "a whole number" if int in kinds else "a number" if float in kinds else ""
    if field is None or not number:
        return "text in quotes" if str in kinds else ""
    limits = [
        f"{sign} {limit}"
        for constraint in field.metadata
        for bound, sign in _LIMITS.items()
        if (limit := getattr(constraint, bound, None)) is not None
    ]
    return f"{number} {' and '.join(limits)}".strip()


def _model_at(location: Location) -> type[Model]:
    """Return the model of the table at a place in the file."""
    models: dict[int | str, type[Model]] = {
        "problems": Problem,
        "kernel": MaternKernel,
        "gap": Gap,
        "space": Range,
        "system": SystemChoice,
    }
    if location and location[0] in ("space", "system"):  # whose keys are the user's
        return models[location[0]]
    names = [part for part in location if part in models]
    return models[names[-1]] if names else CampaignConfig


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
    faults = [
        f"space.{name}: unknown parameter; {spec.name} has {', '.join(known)}" for name in config.space.keys() - known
    ]
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
            limits = [
                f"{sign} {limit:g}" for sign, limit in ((">=", option.low), ("<=", option.high)) if limit is not None
            ]
            allowed = " ".join(["a number", " and ".join(limits), option.unit]).strip()
            faults.append(f"system.{name}: {value!r} is not allowed: allowed is {allowed}")
    return faults


def _within(value: float, low: float | None, high: float | None) -> bool:
    return (low is None or low <= value) and (high is None or value <= high)


def _rollout_faults(config: CampaignConfig, spec: SystemSpec) -> list[str]:
    columns = [column.name for column in spec.columns]
    faults = []
    if config.horizon > spec.max_horizon:
        faults.append(f"horizon: {config.horizon:g} s is more than the {spec.max_horizon:g} s of {spec.name}")
    for problem in config.problems:
        missing = set(ROLLED_OUT[problem.name]) - set(spec.variants)
        if missing:
            faults.append(f"problems.{problem.name}: {spec.name} has no variant {', '.join(sorted(missing))}")
    chosen = {"gap.column": config.gap.column if config.gap else None}
    for problem in config.problems:
        chosen[f"problems.{problem.name}.gap.column"] = problem.gap.column if problem.gap else None
        chosen[f"problems.{problem.name}.column"] = problem.column
    for key, column in chosen.items():
        if column is not None and column not in columns:
            faults.append(f"{key}: no column {column!r}; {spec.name} has {', '.join(columns)}")
    return faults
