"""The system of a campaign file, and its space: all starting conditions of the claim."""

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Discriminator, Field, Tag, model_validator

from ..base import Model
from ..errors import meant
from ..ranges import SEED_BITS
from ..system import AfterEnd, OptionValue, Variant
from ..values import Stamps
from .disturbance import MAX_DISTURBANCES, Disturbance
from .logs import LogMapping
from .parameters import Box, Range

MAX_SCENARIOS = 1000
MAX_TABLE = 10_000
"""Rows of a table of starts; the certificate contains them all."""
SampleFormat = Literal["csv", "f64", "npy"]


class ProgramLimits(Model):
    """What a program may use; the kernel enforces it."""

    memory: float = Field(default=4.0, gt=0, le=1e6, description="address space in GB")
    cpu: float | None = Field(
        default=None, ge=1, le=1e6, description="CPU seconds of one rollout; without it only `deadline` ends one"
    )


class SystemChoice(Model, extra="allow"):
    """The system under test and its options, as its SystemSpec lists them; a program is described here itself."""

    __pydantic_extra__: dict[str, OptionValue] = Field(init=False)
    name: str = Field(
        default="",
        exclude_if=lambda name: name == "",
        description="an installed system: `perfbound systems` lists them",
    )
    python: str | None = Field(
        default=None,
        pattern=r"^[^:]+\.py:[A-Za-z_][A-Za-z0-9_]*$",
        description="FILE.py:NAME, a function or class in a file; its path is relative to the campaign file",
    )

    nominal: "SystemChoice | None" = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="the simulator of the variant `nominal`, in a table `[system.nominal]` like this one",
    )
    true: "SystemChoice | None" = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="beside `[system.nominal]`: that of the variant `true`; of a system with that variant it is that "
        "one",
    )
    files: tuple[str, ...] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        max_length=1000,
        description="of a function or a program: what its rollouts read; files, folders and patterns "
        '("tables/*.csv"), relative to the campaign file',
    )
    stamps: Stamps | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="of a function or a program: sample times are numbers of a step, rounded to float32, or "
        "sums with their round-off",
    )
    after_end: AfterEnd | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="of a function or a program: a rollout that ends before the horizon holds its last state,"
        " or (`fail`) also violates the specification; without this key it is refused, and an environment stepped on "
        "beyond the end of its episode",
    )
    program: tuple[str, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="a program and its arguments; it starts in the folder of the campaign file",
    )
    gymnasium: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        max_length=1000,
        description='an environment as `gymnasium.make` takes it, "CartPole-v1" or "MODULE:NAME-v0"; options of '
        "`[system]` are its arguments",
    )
    fmu: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        max_length=1000,
        description="the file of a Functional Mock-up Unit of FMI 2 or 3, relative to the campaign file; options of "
        "`[system]` are start values of its variables",
    )
    rig: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        pattern=r"^[a-z][a-z0-9-]{0,63}$",
        description="a rig or a vehicle, by a name for it: its rollouts are logs, by `perfbound import` or one by one",
    )
    tolerance: dict[str, Annotated[float, Field(ge=0)]] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        description="of a rig, by parameter: how far the start that was driven may be from the one that was asked for; "
        "it is the column `driven_NAME`",
    )
    logs: LogMapping | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="of a rig: how its logs become columns",
    )
    interface: Literal["co-simulation", "model-exchange"] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="of an FMU that has both; by default `co-simulation`",
    )
    mjcf: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        max_length=1000,
        description="the file of a model for MuJoCo, relative to the campaign file",
    )
    controller: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        pattern=r"^[^:]+\.py:[A-Za-z_][A-Za-z0-9_]*$",
        description="of a model for MuJoCo: FILE.py:NAME, a function of the model and its data that returns the "
        "values of the actuators, or sets them; it is called at every `step`",
    )
    policy: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        pattern=r"^[^:]+\.(py|zip):[A-Za-z_][A-Za-z0-9_]*$",
        description="of an environment, required: FILE.py:NAME, a function or class that returns an action for an "
        "observation, or FILE.zip:PPO, a model of Stable-Baselines3 and its algorithm",
    )
    columns: dict[str, str] | None = Field(
        default=None,
        min_length=1,
        description="of a program, required: columns of its samples in their order, with units, without `t`; of an "
        "environment: those that are recorded, by default every number of the observation, `reward` and numbers of "
        "`info`; of an FMU its outputs, of MuJoCo the sensors; of two simulators, required: those that "
        "both have and that are recorded",
    )
    step: float | None = Field(
        default=None,
        gt=0,
        description="of a program: s between two samples; without it their first column is `t`; of an environment: s "
        "of a step, of an FMU s between two samples, where it does not say so itself; of MuJoCo a multiple of the time "
        "step, which is the default",
    )
    noisy: bool | tuple[Variant, ...] | None = Field(
        default=None,
        description="of a program: the rollouts, or those of these variants, depend on the seed; of an environment "
        "by default true; of an FMU, whose variable `seed` it is then",
    )
    residual: bool | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="of a program with disturbances: whether its rollouts depend on the seed besides; by default true",
    )
    reported: dict[str, Disturbance] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        max_length=MAX_DISTURBANCES,
        description="of a program that draws numbers by itself: the law of each, which is the first sample of the "
        "column of its name",
    )
    variants: tuple[Variant, ...] | None = Field(
        default=None, min_length=1, description="of a program: by default `nominal` alone"
    )
    samples: SampleFormat | None = Field(
        default=None, description="of a program: form of its samples; by default `csv`"
    )
    seed_bits: int | None = Field(
        default=None, ge=31, le=SEED_BITS, description="of a program: seeds are below 2^seed_bits; by default 53"
    )
    limits: ProgramLimits | None = Field(default=None, description="of a program: what it may use")
    environment: tuple[str, ...] | None = Field(
        default=None, description="of a program: variables that it gets besides PATH, HOME and LANG"
    )
    empty_scratch: bool | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="of a program: PERFBOUND_SCRATCH, the folder of its worker, is emptied before every rollout",
    )

    @model_validator(mode="after")
    def _one(self) -> "SystemChoice":
        kinds = [key for key in KINDS if getattr(self, key)]
        if len(kinds) != 1:
            forms = [each.form for each in KINDS.values()]
            near = next(filter(None, (meant(name, KINDS) for name in self.options)), "") if not kinds else ""
            near = f"{' and '.join(kinds)} name several systems; " if kinds else near
            raise ValueError(f"name: {near}give one of {', '.join(forms[:-1])}, and {forms[-1]}")
        kind = KINDS[kinds[0]]
        for key in dict.fromkeys(key for each in KINDS.values() for key in each.keys):
            if getattr(self, key) is None or key in kind.keys:
                continue
            if self.name and key in KINDS["python"].keys:
                raise ValueError(f"{key}: an installed system says this itself, in its class: {key} = ...")
            raise ValueError(f"{key}: this key is for {_kinds_with(key)} alone")
        if missing := next((key for key in kind.required if getattr(self, key) is None), None):
            raise ValueError(f"{missing}: required by {kind.words}: {kind.required[missing]}")
        if self.logs is not None:
            self.logs.check_columns(self.columns or {})
        if self.nominal is not None and self.true is not None:
            self._check_pair(self.nominal, self.true)
        return self

    def _check_pair(self, nominal: "SystemChoice", true: "SystemChoice") -> None:
        for variant, part in (("nominal", nominal), ("true", true)):
            if part.nominal is not None:
                raise ValueError(f"{variant}: is itself two simulators; name one")
        if self.options:
            option = next(iter(self.options))
            raise ValueError(
                f"{option}: an option belongs to one of the simulators, in [system.nominal] or [system.true]"
            )

    @property
    def simulators(self) -> Mapping[Variant, "SystemChoice"]:
        """The systems of the variants, where they are two."""
        return {} if self.nominal is None or self.true is None else {"nominal": self.nominal, "true": self.true}

    @property
    def label(self) -> str:
        """A name of the system for one that is made of two.

        >>> SystemChoice(nominal=SystemChoice(name="segway-mujoco"), true=SystemChoice(python="a.py:Car_2"),
        ...              columns={"phi": "rad"}).label
        'segway-mujoco-and-car-2'
        """
        if self.simulators:
            return "-and-".join(each.label for each in self.simulators.values())
        named = self.program[0] if self.program else str(getattr(self, self.kind))
        found = re.sub("[^a-z0-9]+", "-", named.rpartition(":")[2].rpartition("/")[2].partition(".")[0].lower())
        return found.strip("-") or self.kind

    @property
    def kind(self) -> str:
        """The key that names the system, one of `KINDS`."""
        return next(key for key in KINDS if getattr(self, key))

    @property
    def place(self) -> str:
        """The key that a message about the system names."""
        return "system" if self.simulators else f"system.{self.kind}"

    @property
    def is_described(self) -> bool:
        """Whether the campaign file describes the system: its parameters are those of `[space]`."""
        return KINDS[self.kind].described

    def reference(self, file: Path) -> str:
        """Return the system as a worker finds it: its name, FILE.py:NAME, or the campaign file `file`.

        That describes all other systems, and says what the function in a file does not say itself.
        """
        if self.python is not None and all(getattr(self, key) is None for key in KINDS["python"].keys):
            return str(file.absolute().parent / self.python)
        return self.name or str(file.absolute())

    @property
    def options(self) -> dict[str, OptionValue]:
        """The options that the file sets."""
        return dict(self.__pydantic_extra__ or {})


class Kind(NamedTuple):
    """A way to name a system in `[system]`."""

    words: str
    form: str
    keys: tuple[str, ...] = ()
    """The further keys that it takes."""
    required: Mapping[str, str] = MappingProxyType({})
    """Those that it cannot do without, and what they are."""
    described: bool = False
    """Whether the file describes it, so that `[space]` has its parameters."""
    pattern: str = ""
    """Of the names that say by themselves which kind they are of."""


FUNCTION_KEYS = ("files", "stamps", "after_end")
PROGRAM_KEYS = (
    "columns",
    "step",
    "noisy",
    "residual",
    "reported",
    "variants",
    "samples",
    "seed_bits",
    "limits",
    "environment",
    "empty_scratch",
)
RECORDED_KEYS = ("columns", "step", "files")
"""Of a system that is stepped by us."""
KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "name": Kind("an installed system", 'name = "...", an installed system'),
        "python": Kind("a function", 'python = "FILE.py:NAME", a function in a file', FUNCTION_KEYS),
        "program": Kind(
            "a program",
            'program = ["./NAME"]',
            (*FUNCTION_KEYS, *PROGRAM_KEYS),
            {"columns": 'its columns with their units, { distance = "m" }'},
            described=True,
        ),
        "gymnasium": Kind(
            "an environment of Gymnasium",
            'gymnasium = "CartPole-v1"',
            (*RECORDED_KEYS, "policy", "noisy", "after_end"),
            {"policy": '"policy.py:act", a function that returns an action for an observation'},
            described=True,
            pattern="-v[0-9]+$",
        ),
        "fmu": Kind(
            "an FMU",
            'fmu = "NAME.fmu"',
            (*RECORDED_KEYS, "interface", "noisy", "after_end"),
            described=True,
            pattern=r"\.fmu$",
        ),
        "mjcf": Kind(
            "a model for MuJoCo", 'mjcf = "NAME.xml"', (*RECORDED_KEYS, "controller"), described=True, pattern=r"\.xml$"
        ),
        "rig": Kind(
            "a rig",
            'rig = "NAME"',
            ("columns", "step", "noisy", "stamps", "after_end", "reported", "tolerance", "logs"),
            {"columns": 'its columns with their units, { distance = "m" }'},
            described=True,
        ),
        "nominal": Kind(
            "two simulators",
            "[system.nominal] and [system.true], two simulators",
            ("true", "columns"),
            {
                "true": "a table [system.true] with the other one",
                "columns": 'those that both have, with units, { phi = "rad" }',
            },
        ),
    }
)
"""By the key of `[system]` that names the system."""


def kind_named(name: str) -> str | None:
    """Return the kind of a system that a name says by itself, as that of its model does; None for another name.

    >>> kind_named("models/Tank.fmu"), kind_named("CartPole-v1"), kind_named("cars.py:cars")
    ('fmu', 'gymnasium', None)
    """
    return next((key for key, each in KINDS.items() if each.pattern and re.search(each.pattern, name)), None)


def _kinds_with(key: str) -> str:
    *others, last = (each.words for each in KINDS.values() if key in each.keys)
    return f"{', '.join(others)} and {last}" if others else last


Header = Annotated[
    tuple[str, ...] | None,
    # No part of the campaign, which is the same one without a header.
    Field(exclude=True, description="words above the columns; a parameter's name has to be above its own column"),
]


class Scenarios(Model):
    """Finitely many starting conditions; the claim is about these alone."""

    scenarios: tuple[tuple[float, ...], ...] = Field(
        min_length=1,
        max_length=MAX_SCENARIOS,
        description="starts, one number per parameter of the system; or the name of a CSV file beside this one",
    )
    header: Header = None

    @model_validator(mode="after")
    def _distinct(self) -> "Scenarios":
        seen: dict[tuple[float, ...], int] = {}
        for number, scenario in enumerate(self.scenarios):
            if len(scenario) != len(self.scenarios[0]):
                numbers = f"{len(scenario)} numbers, the first {len(self.scenarios[0])}"
                raise ValueError(f"scenarios: entry {number} has {numbers}")
            if scenario in seen:
                raise ValueError(f"scenarios: entries {seen[scenario]} and {number} are the same, {list(scenario)}")
            seen[scenario] = number
        return self

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """The starts, parameters in the order of the system."""
        return self.scenarios


class StartTable(Model):
    """A table of starts, drawn with replacement: a row that is there twice is drawn twice as often."""

    table: tuple[tuple[float, ...], ...] = Field(
        min_length=1,
        max_length=MAX_TABLE,
        description="the name of a CSV file beside this one, or its rows, one number per parameter of the system",
    )
    header: Header = None

    @model_validator(mode="after")
    def _rectangular(self) -> "StartTable":
        width = len(self.table[0])
        for number, row in enumerate(self.table):
            if not row or len(row) != width:
                raise ValueError(
                    f"table: row {number} has {len(row)} numbers, the first {width}; give one per parameter in each row"
                )
        return self

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """The starts, parameters in the order of the system."""
        return self.table


SpaceKind = Literal["box", "distributions", "scenarios", "table"]
"""Ranges alone, ranges of which one has a distribution, steps or choices, a list of all starts, starts to draw from."""


def _space_model(value: Any) -> str:
    if isinstance(value, Scenarios) or (isinstance(value, dict) and "scenarios" in value):
        return "scenarios"
    # A parameter may be called `table`: its value is a range.
    listed = isinstance(value, dict) and "table" in value and not isinstance(value["table"], dict | Range)
    return "table" if isinstance(value, StartTable) or listed else "box"


Space = Annotated[
    Annotated[Box, Tag("box"), Field(min_length=1)]
    | Annotated[Scenarios, Tag("scenarios")]
    | Annotated[StartTable, Tag("table")],
    Discriminator(_space_model),
]


def space_kind(space: Space) -> SpaceKind:
    """Return the kind of a space."""
    if isinstance(space, Scenarios):
        return "scenarios"
    if isinstance(space, StartTable):
        return "table"
    return "distributions" if any(each.for_draws for each in space.values()) else "box"
