"""The values of a first campaign that follow from a pilot, or are guessed."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...schemas.file.objectives import ProblemName


@dataclass(frozen=True, slots=True)
class Constants:
    """What one problem assumes about its objective."""

    prior_mean: float
    rkhs_norm: float
    noise_scale: float | str
    """`derived`, where the clip bounds the noise better than the rollouts show it."""
    alpha: float


@dataclass(frozen=True, slots=True)
class FirstValues:
    """What a first campaign assumes, from a pilot or guessed."""

    source: str
    """Of the values, in a sentence."""
    horizon: float
    """In s; 0 for rollouts of one sample."""
    specification: str
    about: str
    """Of the specification, in a sentence."""
    clip: tuple[float, float] | None
    constants: dict["ProblemName", Constants]
    """Of each problem, in the order of the file; empty where a claim needs none."""
    guess: str = ""
    """Ends the meaning of clip and constants that no pilot shows."""
