"""The system of a campaign file, and its space: all starting conditions of the claim."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from .base import Model
from .ranges import SEED_BITS
from .system import OptionValue, Variant

MAX_SCENARIOS = 1000
SampleFormat = Literal["csv", "f64", "npy"]


class ProgramLimits(Model):
    """What a program may use; the kernel enforces it."""

    memory: float = Field(default=4.0, gt=0, le=1e6, description="address space in GB; more of it cannot be allocated")
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

    program: tuple[str, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="a program and its arguments; it is started in the folder of the campaign file",
    )
    columns: dict[str, str] | None = Field(
        default=None,
        min_length=1,
        description="of a program, required: columns of its samples with their units, in their order, without `t`",
    )
    step: float | None = Field(
        default=None, gt=0, description="of a program: s between two samples; without it their first column is `t`"
    )
    noisy: bool | tuple[Variant, ...] | None = Field(
        default=None, description="of a program: the rollouts, or those of these variants, depend on the seed"
    )
    variants: tuple[Variant, ...] | None = Field(
        default=None, min_length=1, description="of a program: its variants; without this key it has one, `nominal`"
    )
    samples: SampleFormat | None = Field(
        default=None, description="of a program: the form of its samples; without this key `csv`"
    )
    seed_bits: int | None = Field(
        default=None, ge=31, le=SEED_BITS, description="of a program: seeds are below 2^seed_bits; without this key 53"
    )
    limits: ProgramLimits | None = Field(default=None, description="of a program: memory and CPU time that it may use")
    environment: tuple[str, ...] | None = Field(
        default=None, description="of a program: variables that it gets besides PATH, HOME and LANG"
    )

    @model_validator(mode="after")
    def _one(self) -> "SystemChoice":
        if [self.name != "", self.python is not None, self.program is not None].count(True) != 1:
            raise ValueError(
                'name: give one of name = "...", an installed system, python = "FILE.py:NAME", a function in a file, '
                'and program = ["./NAME"]'
            )
        if self.program is not None and self.columns is None:
            raise ValueError('columns: required by a program: its columns with their units, { distance = "m" }')
        given = [key for key in PROGRAM_KEYS if getattr(self, key) is not None]
        if self.program is None and given:
            raise ValueError(f"{given[0]}: this key is for a program alone")
        return self

    @property
    def kind(self) -> Literal["name", "python", "program"]:
        """The key that names the system."""
        return "name" if self.name else "python" if self.python is not None else "program"

    def reference(self, file: Path) -> str:
        """Return the system as a worker finds it: its name, FILE.py:NAME, or for a program the campaign file `file`."""
        if self.python is not None:
            return str(file.absolute().parent / self.python)
        return self.name or str(file.absolute())

    @property
    def options(self) -> dict[str, OptionValue]:
        """The options that the file sets."""
        return dict(self.__pydantic_extra__ or {})


PROGRAM_KEYS = ("columns", "step", "noisy", "variants", "samples", "seed_bits", "limits", "environment")
"""Keys of `[system]` that describe a program."""


class Range(Model):
    """All values of one parameter of the starting condition d."""

    low: float = Field(description="smallest value")
    high: float = Field(description="largest value")
    unit: str = Field(default="", description="if given, must be that of the system's parameter")

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if not self.low < self.high:
            raise ValueError(f"low: {self.low:g} must be less than high = {self.high:g}")
        return self


class Scenarios(Model):
    """Finitely many starting conditions; the claim is about these alone."""

    scenarios: tuple[tuple[float, ...], ...] = Field(
        min_length=1,
        max_length=MAX_SCENARIOS,
        description="starts, one number per parameter of the system; or the name of a CSV file beside this one",
    )

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


Box = dict[str, Range]


def _space_kind(value: Any) -> str:
    return "scenarios" if isinstance(value, Scenarios) or (isinstance(value, dict) and "scenarios" in value) else "box"


Space = Annotated[
    Annotated[Box, Tag("box"), Field(min_length=1)] | Annotated[Scenarios, Tag("scenarios")],
    Discriminator(_space_kind),
]
