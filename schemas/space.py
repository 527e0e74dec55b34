"""The system of a campaign file, and its space: all starting conditions of the claim."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from .base import Model
from .system import OptionValue

MAX_SCENARIOS = 1000


class SystemChoice(Model, extra="allow"):
    """The system under test and its options, as its SystemSpec lists them."""

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

    @model_validator(mode="after")
    def _one(self) -> "SystemChoice":
        if (self.name == "") == (self.python is None):
            raise ValueError('name: give either name = "...", an installed system, or python = "FILE.py:NAME"')
        return self

    def reference(self, folder: Path) -> str:
        """Return the system as a worker finds it, given the folder of the campaign file."""
        return self.name if self.python is None else str(folder.absolute() / self.python)

    @property
    def options(self) -> dict[str, OptionValue]:
        """The options that the file sets."""
        return dict(self.__pydantic_extra__ or {})


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
