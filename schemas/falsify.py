"""The search of a campaign for a counterexample."""

from pydantic import Field

from .base import Model


class Falsify(Model):
    """Where tests come from while a start is sought at which the system fails; an empty table takes every default."""

    random_every: int = Field(
        default=4,
        ge=1,
        le=1000,
        description="of so many tests one is at random, whatever was observed; with method `sample` these alone are "
        "samples, and the others enter no claim",
    )

    def is_random(self, test: int) -> bool:
        """Whether no outcome chooses the start of test `test`: the last of each `random_every`."""
        return (test + 1) % self.random_every == 0
