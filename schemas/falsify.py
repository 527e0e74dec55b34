"""The search of a campaign for a counterexample."""

from pydantic import Field, model_validator

from .base import Model


class Falsify(Model):
    """Where tests come from while a start is sought at which the system fails; an empty table takes every default."""

    random_every: int = Field(
        default=4,
        ge=1,
        le=1000,
        description="of so many tests one is at random; with method `sample` only these are samples, and the others "
        "enter no claim",
    )

    shrink: bool = Field(
        default=False,
        exclude_if=lambda shrink: not shrink,
        description="move the counterexample towards `nominal` by bisection, as long as the system fails there",
    )
    nominal: dict[str, float] = Field(
        default={},
        exclude_if=lambda nominal: not nominal,
        description="with `shrink`: values of some parameters; by default the middle of each range",
    )
    shrink_tests: int = Field(
        default=20,
        ge=1,
        le=1000,
        exclude_if=lambda tests: tests == 20,
        description="most rollouts for it; no claim uses them",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "Falsify":
        if self.nominal and not self.shrink:
            raise ValueError("nominal: it is where `shrink` goes; add shrink = true, or remove this key")
        return self

    def is_random(self, test: int) -> bool:
        """Whether no outcome chooses the start of test `test`: the last of each `random_every`."""
        return (test + 1) % self.random_every == 0
