"""The specification of a system under test, which workers announce so that the orchestrator need not import it."""

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from .base import Model, digest
from .errors import DefinitionError
from .file.disturbance import MAX_DISTURBANCES, Disturbance
from .file.signals import SignalShape
from .ranges import MAX_FILE_BYTES, SEED_BITS, FileBytes, Magnitude, Seconds, SeedBits
from .values import FORMULA_WORDS, Stamps
from .written import Written

SCORED = "sd"
"""Unit of a disturbance that is a parameter in scores: normal quantiles of its distribution function."""
DECIDES_NO_ROLLOUT = {"default_horizon", "trajectory_bytes"}
"""Keys that are no part of a system's identity: every request has its own horizon, and no file depends on its limit."""
PART = 12
"""Digits of the digest of one file or package in a heartbeat."""
SPARE = 10
"""A trajectory's file may be so many times as large as its system declares."""
ASSUMED_HORIZON = 10.0
"""Seconds, where neither the user nor the system names a horizon."""
Variant = Literal["nominal", "true"]
OptionValue = str | Magnitude
AfterEnd = Literal["hold", "fail"]
"""What a rollout that ends before the horizon is: its last state stays, or it violates the specification besides."""


class Parameter(Model, metaclass=Written):
    """One component of the starting condition d: `Parameter(low, high, unit=...)`, or by names.

    The name may be left out where the parameter stands under it, as in the decorator of a function.
    """

    takes_limits: ClassVar[bool] = True
    name: str = Field(default="", pattern=r"^([a-z][a-z0-9_]*)?$")
    unit: str = ""
    low: Magnitude
    high: Magnitude
    signal: bool = Field(
        default=False,
        exclude_if=lambda signal: not signal,
        description="an input over time; the campaign chooses its interpolation and its knots",
    )

    @model_validator(mode="after")
    def _ordered(self) -> "Parameter":
        if self.low > self.high:
            raise ValueError(f"its lower end {self.low:g} is above its upper end {self.high:g}; exchange them")
        return self

    @property
    def range_words(self) -> str:
        """The range with its unit, if it has one."""
        return f"[{self.low:g}, {self.high:g}] {self.unit}".rstrip()

    if TYPE_CHECKING:  # else pydantic would call it for each parameter of a message

        def __init__(self, *limits: float, **fields: Any) -> None: ...


class Column(Model, metaclass=Written):
    """One column of the trajectory."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    unit: str

    @field_validator("name")
    @classmethod
    def _can_be_named(cls, name: str) -> str:
        if name in FORMULA_WORDS:
            raise ValueError(f"{name!r} is a word of specifications; choose another name for the column")
        return name


class Option(Model, metaclass=Written):
    """One key that `[system]` of a campaign file may set: a choice of words or a number in [low, high]."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    default: OptionValue
    choices: tuple[str, ...] = ()
    low: Magnitude | None = None
    high: Magnitude | None = None
    unit: str = ""
    doc: str = ""

    @property
    def allowed_numbers(self) -> str:
        """The numbers that the option takes, in words.

        >>> Option(name="noise_sd", default=0.1, low=0.0, unit="m").allowed_numbers
        'a number >= 0 m'
        """
        limits = [f"{sign} {limit:g}" for sign, limit in ((">=", self.low), ("<=", self.high)) if limit is not None]
        return " ".join(filter(None, ["a number", " and ".join(limits), self.unit]))


class SystemSpec(Model, metaclass=Written):
    """A system under test: its parameters and options, its columns, and its software.

    `columns` starts with the time `t` in seconds. `noisy` names the variants that depend on chance:
    on the seed, or on disturbances.
    `versions` are those of the packages that decide the trajectory, e.g. {"pybullet": "3.2.7"}; `code` are the source
    files, filled in where the system is loaded. Seeds are below 2^`seed_bits`: 32 for an unsigned int.
    """

    is_short: ClassVar[bool] = False
    joint: ClassVar[str] = "-"
    name: str = Field(pattern=r"^[a-z][a-z0-9-]*$")
    doc: str
    parameters: tuple[Parameter, ...] = Field(min_length=1)
    columns: tuple[Column, ...] = Field(min_length=2)
    options: tuple[Option, ...] = ()
    variants: tuple[Variant, ...] = ("nominal", "true")
    noisy: tuple[Variant, ...] = ("true",)
    max_horizon: Seconds = Field(gt=0, description="longest rollout in seconds")
    versions: dict[str, str] = Field(default_factory=dict)
    timed: bool = Field(default=False, description="a rollout takes a horizon above 0 s")
    code: dict[str, str] = Field(default_factory=dict, description="sha256 of every source file")
    default_horizon: Seconds | None = Field(
        default=None, description="horizon in s where the user names none; 0 for rollouts of one sample"
    )
    seed_bits: SeedBits = Field(default=SEED_BITS, description="seeds are below 2^seed_bits")
    repeated: Literal["anywhere", "session", "nowhere"] = Field(
        default="anywhere",
        description="where a rollout can be made again: where the system is, in the interactive session that "
        "defined it, or nowhere, as on a rig",
    )
    trajectory_bytes: FileBytes | None = Field(
        default=None, description="size of a trajectory's file; one of more than ten times as many is refused unread"
    )

    stamps: Stamps = Field(
        default="exact",
        description="the times of samples: numbers of a step, rounded to float32, or sums with their round-off",
    )
    after_end: AfterEnd | None = Field(
        default=None,
        description="what a rollout that ends before the horizon is: its last state is held, or it fails besides; "
        "without this key it is refused. The last column is then `ended`",
    )

    vectorised: bool = Field(
        default=False, description="the system simulates many rollouts in one call, as arrays over them"
    )
    batch_is_the_unit: bool = Field(
        default=False,
        description="the last digits of a rollout depend on the size of its batch and on its place in it, so that only "
        "the batch as a whole can be repeated",
    )

    disturbances: tuple[Disturbance, ...] = Field(
        default=(),
        max_length=MAX_DISTURBANCES,
        exclude_if=lambda disturbances: not disturbances,
        description="what is random in the rollouts of the `noisy` variants; the campaign draws their values",
    )
    residual: bool = Field(
        default=True,
        exclude_if=lambda residual: residual,
        description="whether rollouts of the `noisy` variants depend on their seed besides the disturbances",
    )

    reported: tuple[Disturbance, ...] = Field(
        default=(),
        max_length=MAX_DISTURBANCES,
        exclude_if=lambda reported: not reported,
        description="what the system draws by itself in the `noisy` variants: each is the first sample of the column "
        "of its name",
    )

    simulators: dict[Variant, str] = Field(
        default_factory=dict,
        exclude_if=lambda simulators: not simulators,
        description="of two simulators: the identity of that of each variant",
    )
    undisturbed: tuple[Variant, ...] = Field(
        default=(),
        exclude_if=lambda variants: not variants,
        description="of two simulators: the variant whose one takes no disturbances",
    )

    signals: tuple[SignalShape, ...] = Field(
        default=(),
        exclude_if=lambda signals: not signals,
        description="of a campaign: the input signals whose knots are among the parameters",
    )
    undivided: tuple[Parameter, ...] = Field(
        default=(),
        exclude_if=lambda parameters: not parameters,
        description="of a campaign with input signals whose parameters are not knots alone: the parameters that the "
        "system declares",
    )
    own_disturbances: tuple[Disturbance, ...] = Field(
        default=(),
        exclude_if=lambda disturbances: not disturbances,
        description="of a campaign that gives disturbances other laws: those that the system declares",
    )
    as_parameters: tuple[str, ...] = Field(
        default=(),
        max_length=MAX_DISTURBANCES,
        exclude_if=lambda names: not names,
        description="of a campaign: the disturbances that are the last of its parameters, with the unit `sd` in scores",
    )
    disturbed: tuple[Variant, ...] = Field(
        default=(),
        exclude_if=lambda variants: not variants,
        description="of a campaign with some of these: the variants that disturbances act in",
    )

    @model_validator(mode="after")
    def _disturbed(self) -> "SystemSpec":
        _check_disturbances(self)
        _check_reported(self)
        return self

    @model_validator(mode="after")
    def _batched(self) -> "SystemSpec":
        if self.batch_is_the_unit and not self.vectorised:
            raise ValueError("batch_is_the_unit: only a vectorised system simulates its batches together")
        # A vectorised rollout that has ended continues in the arrays, and an input is a function of one rollout.
        without = {"after_end": self.after_end, "signals": any(each.signal for each in self.parameters)}
        if self.vectorised and (given := [name for name, value in without.items() if value]):
            raise ValueError(f"vectorised: not together with {given[0]}")
        return self

    @model_validator(mode="after")
    def _named(self) -> "SystemSpec":
        if any(not each.name for each in self.parameters):
            raise ValueError("parameters: every parameter needs a name")
        if self.after_end is not None and self.columns[-1].name != ENDED.name:
            raise ValueError(f"columns: with after_end the last one is {ENDED.name}, which is 1 after an early end")
        for signal in (each.name for each in self.parameters if each.signal):
            for other in self.parameters:
                if re.fullmatch(rf"{signal}_[0-9]+", other.name):
                    raise ValueError(
                        f"parameters: {other.name} is the name of a knot of {signal}, an input over time; choose "
                        "another name"
                    )
        return self

    def spread(
        self,
        shapes: Iterable[SignalShape] = (),
        laws: Mapping[str, Disturbance] | None = None,
        added: Mapping[str, Parameter] | None = None,
        *,
        drawn: bool = False,
    ) -> "SystemSpec":
        """Return the system as a campaign knows it: the knots of its input signals are parameters, and `laws` hold.

        `added` are the disturbances that are parameters, too; `drawn`, whether some starts are drawn with them.
        Signals that `shapes` does not have get the default shape; those that are recorded are columns behind those of
        the system. The identity stays that of the system.
        """
        given = {each.name: each for each in shapes}
        found = {
            each.name: given.get(each.name) or SignalShape(name=each.name) for each in self.parameters if each.signal
        }
        if not (found or laws or added):  # of most systems, for every rollout on a worker
            return self
        parameters = tuple(
            each.model_copy(update={"name": name, "signal": False, **differs})
            for each in self.parameters
            for name, differs in (found[each.name].parameters() if each.signal else ((each.name, {}),))
        )
        changed = tuple((laws or {}).get(each.name, each).named(each.name, each.unit) for each in self.disturbances)
        update: dict[str, Any] = {"parameters": parameters, "signals": tuple(found.values())} if found else {}
        if not all(each.knots_alike for each in found.values()):
            update["undivided"] = self.parameters
        if recorded := [each.name for each in found.values() if each.recorded]:
            update["columns"] = _columns_with(self, recorded)
        if changed != self.disturbances:
            update |= {"disturbances": changed, "own_disturbances": self.disturbances}
        if added and not self.as_parameters:
            names = tuple(each.name for each in self.disturbances if each.name in added)
            update |= {"parameters": (*parameters, *map(added.__getitem__, names))}
            update |= {"as_parameters": names, "disturbed": self.noisy}
            # Nothing is left to chance.
            if len(names) == len(self.disturbances) and not (self.residual or drawn):
                update["noisy"] = ()
        return self.model_copy(update=update) if update else self

    @property
    def declared(self) -> "SystemSpec":
        """The system as it describes itself: the inverse of `spread`."""
        if self.as_parameters:
            return self.as_simulated.declared
        if not (self.signals or self.own_disturbances):
            return self
        return self.model_copy(
            update={
                "parameters": self.undivided or _undivided(self),
                "columns": tuple(column for column in self.columns if column.name not in self.recorded),
                "signals": (),
                "undivided": (),
                "disturbances": self.own_disturbances or self.disturbances,
                "own_disturbances": (),
            }
        )

    @property
    def as_simulated(self) -> "SystemSpec":
        """The system as workers know it: no disturbance is a parameter."""
        if not self.as_parameters:
            return self
        update = {"parameters": self.own_parameters, "noisy": self.disturbed, "as_parameters": (), "disturbed": ()}
        return self.model_copy(update=update)

    @property
    def own_parameters(self) -> tuple[Parameter, ...]:
        """The parameters of a rollout's start: those that are no disturbances."""
        return self.parameters[: len(self.parameters) - len(self.as_parameters)]

    @property
    def numbers(self) -> int:
        """Numbers of a start in a request, which has it twice where disturbances are parameters."""
        return len(self.parameters) * (2 if self.as_parameters else 1)

    @property
    def drawn(self) -> tuple[Disturbance, ...]:
        """The disturbances that are drawn: those that are no parameters."""
        return tuple(self.disturbances[place] for place in self.drawn_places)

    @property
    def drawn_places(self) -> tuple[int, ...]:
        """Their places among the disturbances."""
        return tuple(k for k, law in enumerate(self.disturbances) if law.name not in self.as_parameters)

    @property
    def explaining(self) -> tuple[Disturbance, ...]:
        """The disturbances of a rollout whose values are known: those that are drawn, then those that it reports."""
        return (*self.drawn, *self.reported)

    @property
    def recorded(self) -> tuple[str, ...]:
        """The input signals that are columns, which the system itself does not give."""
        return tuple(each.name for each in self.signals if each.recorded)

    @property
    def own_columns(self) -> tuple[str, ...]:
        """The names of the columns that the system itself gives."""
        names = tuple(column.name for column in self.columns if column.name not in self.recorded)
        return names if self.after_end is None else names[:-1]

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column, by its name."""
        return {column.name: column.unit for column in self.columns}

    def with_said(self, stamps: Stamps | None, after_end: AfterEnd | None) -> "SystemSpec":
        """Return the system with what a campaign file says of its times and early ends, if it says something.

        Raises:
            DefinitionError: the system says otherwise.

        """
        found = self.model_copy(update={} if stamps is None else {"stamps": stamps})
        if after_end is None or after_end == self.after_end:
            return found
        if self.after_end is not None:
            raise DefinitionError(
                f"after_end: is {after_end!r}, and the system itself says {self.after_end!r}; leave it out here"
            )
        columns = timed_columns({each.name: each.unit for each in self.columns[1:]}, after_end)
        return found.model_copy(update={"after_end": after_end, "columns": columns})

    @property
    def assumed_horizon(self) -> float:
        """Horizon in s of a command that is given none: the system's own, else `ASSUMED_HORIZON`."""
        own = ASSUMED_HORIZON if self.default_horizon is None else self.default_horizon
        return min(own, self.max_horizon)

    @property
    def largest_file(self) -> int:
        """Bytes of the largest file of a trajectory that is accepted."""
        return min(SPARE * (self.trajectory_bytes or MAX_FILE_BYTES), MAX_FILE_BYTES)

    @property
    def digest(self) -> str:
        """Identity of this exact system; workers that announce another one are refused."""
        # A key that a later version adds changes nothing while it is not set. A changed default does.
        return digest(self.declared.model_dump(mode="json", exclude_defaults=True, exclude=DECIDES_NO_ROLLOUT))

    @property
    def parts(self) -> dict[str, str]:
        """Short digest -> name of every file and package of the system, with which a worker shows what it has."""
        files = {f"{name} {sha256}": name for name, sha256 in self.code.items()}
        packages = {f"{name} {version}": f"{name} {version}" for name, version in self.versions.items()}
        return {hashlib.sha256(text.encode()).hexdigest()[:PART]: label for text, label in (files | packages).items()}


def differences(spec: SystemSpec, here: SystemSpec) -> list[str]:
    """Return in what the same system is another one here: files, versions, then other keys, with both values.

    >>> one = SystemSpec(name="a", doc="", parameters=(Parameter(0, 1, name="x"),),
    ...                  columns=(Column(name="t", unit="s"), Column(name="y", unit="m")), max_horizon=1,
    ...                  versions={"numpy": "1.26"}, code={"a.py": "0" * 64, "b.py": "1" * 64})
    >>> differences(one, one.model_copy(update={"versions": {"numpy": "2.0"}, "code": {"a.py": "0" * 64}}))
    ['b.py is missing here', 'numpy 1.26 (here 2.0)']
    """
    code = [
        f"{name} is {'another one' if name in spec.code else 'new'} here"
        if name in here.code
        else f"{name} is missing here"
        for name in sorted(spec.code.keys() | here.code.keys())
        if spec.code.get(name) != here.code.get(name)
    ]
    versions = [
        f"{name} {spec.versions.get(name, 'none')} (here {here.versions.get(name, 'none')})"
        for name in sorted(spec.versions.keys() | here.versions.keys())
        if spec.versions.get(name) != here.versions.get(name)
    ]
    known, found = ({each.name: each for each in one.declared.parameters} for one in (spec, here))
    parameters = [
        f"parameter {name} {_range_words(known.get(name))} (here {_range_words(found.get(name))})"
        for name in dict.fromkeys((*known, *found))
        if known.get(name) != found.get(name)
    ]
    seen = {"code", "versions", *DECIDES_NO_ROLLOUT, *(["parameters"] if parameters else [])}
    others = [
        f"{key} {_short(getattr(spec, key))} (here {_short(getattr(here, key))})"
        for key in type(spec).model_fields
        if key not in seen and getattr(spec.declared, key) != getattr(here.declared, key)
    ]
    return code + versions + parameters + others


def _columns_with(spec: SystemSpec, recorded: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns of a system with those of input signals, behind its own."""
    units, own = {each.name: each.unit for each in spec.parameters}, len(spec.own_columns)
    added = (Column(name=name, unit=units[name]) for name in recorded)
    return (*spec.columns[:own], *added, *spec.columns[own:])


def _undivided(spec: SystemSpec) -> tuple[Parameter, ...]:
    """Return the parameters of a system whose signals have knots alone: all knots of one are alike."""
    names = {name: shape.name for shape in spec.signals for name in shape.names}
    found: dict[str, Parameter] = {}
    for each in spec.parameters:
        if (name := names.get(each.name, each.name)) not in found:
            found[name] = each.model_copy(update={"name": name, "signal": True}) if each.name in names else each
    return tuple(found.values())


def _range_words(parameter: Parameter | None) -> str:
    """Return the range of a parameter in words."""
    if parameter is None:
        return "none"
    return f"in {parameter.range_words}" + (", an input over time" if parameter.signal else "")


def _check_disturbances(spec: SystemSpec) -> None:
    """Refuse disturbances that a system cannot have; raises ValueError."""
    if spec.disturbances and not (spec.noisy or spec.disturbed):
        raise ValueError("disturbances: no variant is noisy, so that none of them has an effect")
    if not (spec.residual or spec.disturbances):
        raise ValueError("residual: false is for a system with disturbances; without any, let no variant be noisy")
    taken = {*(each.name for each in spec.own_parameters), *(each.name for each in spec.options)}
    for name in [each.name for each in spec.disturbances]:
        if not name:
            raise ValueError('disturbances: one has no name; write Normal(0, 1).named("gust", "m/s")')
        if name in taken:
            what = f"{name} is that of a parameter, an option or another disturbance"
            raise ValueError(f"disturbances: every one needs a name of its own; {what}")
        taken.add(name)
    if SCORED in {each.unit for each in spec.disturbances}:
        raise ValueError(f"disturbances: {SCORED!r} is the unit of scores; give one of them another unit")


def _check_reported(spec: SystemSpec) -> None:
    """Refuse numbers that a system cannot report; raises ValueError."""
    if spec.reported and not (spec.noisy or spec.disturbed):
        raise ValueError("reported: no variant is noisy, so that none draws a number")
    if spec.reported and not spec.residual:
        raise ValueError("residual: false is not for a system that draws numbers by itself; leave it out")
    units = {column.name: column.unit for column in spec.columns if column.name in spec.own_columns[1:]}
    drawn = {each.name for each in spec.disturbances}
    for name, unit in ((each.name, each.unit) for each in spec.reported):
        if name not in units:
            raise ValueError(f"reported: {name!r} is no column; add it, with the number in its first sample")
        if name in drawn:
            raise ValueError(f"reported: {name} is drawn by the campaign; remove it from here or from disturbances")
        if unit != units[name]:
            raise ValueError(f"reported: {name} is in {unit or 'no unit'!r}, and its column in {units[name]!r}")
    for law in spec.reported:
        if law.choices is not None and len(set(law.choices)) < len(law.choices):
            raise ValueError(f"reported: {law.name} has a choice twice; give it once, with its whole probability")
    if len({each.name for each in spec.reported}) < len(spec.reported):
        raise ValueError("reported: every number needs a column of its own")


ENDED = Column(name="ended", unit="1")
"""The last column of a system with `after_end`: 0 while it runs, 1 where its last state is held."""


def timed_columns(units: Mapping[str, str], after_end: AfterEnd | None = None) -> tuple[Column, ...]:
    """Return the columns of a system: the time, those that its author declares, and that of an early end.

    Raises:
        DefinitionError: a name is none, or is that of the column of an early end.

    """
    if after_end is not None and ENDED.name in units:
        raise DefinitionError(f"columns: {ENDED.name} is the column that after_end adds; leave it out")
    own = tuple(Column(name=name, unit=unit) for name, unit in {"t": "s", **units}.items())
    return own if after_end is None else (*own, ENDED)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
