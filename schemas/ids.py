"""Names of a rollout and of an attempt at it: the only reader and writer of their text form."""

from dataclasses import dataclass
from typing import NamedTuple

SPOT_CHECK, SHRINK, RECHECK = CLOSING = ("spot_check", "shrink", "recheck")
"""The closing checks: series of tests that follow those of the problems, in this order."""


class RolloutId(NamedTuple):
    """One rollout of the campaign."""

    problem: str
    test: int
    variant: str
    replicate: int

    def __str__(self) -> str:
        return f"{self.problem}.{self.test}.{self.variant}.{self.replicate}"

    @classmethod
    def parse(cls, text: str) -> "RolloutId":
        """Read the text form.

        Raises:
            ValueError: `text` is not of the form problem.test.variant.replicate.

        >>> RolloutId.parse("sim_gap.3.true.0")
        RolloutId(problem='sim_gap', test=3, variant='true', replicate=0)

        """
        problem, test, variant, replicate = text.split(".")
        return cls(problem, int(test), variant, int(replicate))


@dataclass(frozen=True, slots=True)
class Attempt:
    """One try of a rollout; numbered from 1."""

    rollout: RolloutId
    number: int
