"""Constants of a first campaign, proposed from a few rollouts; every one is an assumption that the user may change.

| symbol | name      | meaning                                                           | shape  | unit |
|--------|-----------|-------------------------------------------------------------------|--------|------|
| z      | `starts`  | starting conditions of the pilot                                  | (n, p) | parameter |
| J      | `values`  | maximised objective of k rollouts at each start, with other seeds | (n, k) | J |
| m0, B  |           | prior mean and norm bound of J - m0                               | ()     | J |
| R      |           | sub-Gaussian scale of the noise of one rollout                    | ()     | J |
| s      | `sd`      | largest standard deviation of the rollouts at one start           | ()     | J |
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from typing import TYPE_CHECKING

import numpy as np

from ....schemas.errors import PerfboundError
from ....schemas.file.defaults import derived_lengths
from ....schemas.system import Parameter, SystemSpec
from ....schemas.trajectory.trajectory import Trajectory
from ...campaign.objectives import scored
from ...mathematics.gp.kernels import Floats, Matern, scaled
from ...mathematics.stl.parser import FormulaError, parse_formula

if TYPE_CHECKING:
    from ....schemas.file.objectives import ProblemName


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


Score = Callable[[Trajectory], float]
"""From a rollout to one number, of which more is better."""
NU = 2.5
"""Smoothness of the kernel."""
CORNERS, INNER = 8, 16
"""Starts of a pilot at corners of the box, where a system is often at its worst, and in it."""
NOISY_ROLLOUTS = 2
"""Rollouts at each start where they depend on the seed."""
NORM_FACTOR = 2.0
"""The campaign sees more of the objective than a pilot, and finds larger norms."""
NOISE_FACTOR = 1.5
"""Of the largest s. A smaller factor, or a mean over neighbours, is often below a noise that grows to one side."""
NOISE_OF_FIT = 0.02
"""Least noise that a fit to exact values assumes, in parts of their spread: it follows no kink with all its norm."""


def pilot_starts(parameters: Sequence[Parameter]) -> list[tuple[float, ...]]:
    """Return starts over the whole ranges of the parameters: corners of the box, then evenly inside; without chance."""
    from scipy.stats import qmc  # noqa: PLC0415  (most commands need no sequence)

    count = len(parameters)
    corners = list(itertools.islice(itertools.product((0.0, 1.0), repeat=count), CORNERS))
    if 2**count > CORNERS:
        corners = np.random.default_rng(0).integers(0, 2, (CORNERS, count)).tolist()
    inner = qmc.Halton(count, scramble=False).random(INNER + 1)[1:].tolist()  # the first point is a corner
    return [
        tuple(
            min(max(each.low + share * (each.high - each.low), each.low), each.high)
            for each, share in zip(parameters, shares, strict=True)
        )
        for shares in dict.fromkeys(map(tuple, [*corners, *inner]))
    ]


def length_scales(parameters: Sequence[Parameter]) -> dict[str, float]:
    """Return the length scale that a campaign file without a kernel has, for each parameter."""
    return derived_lengths({each.name: (each.low, each.high) for each in parameters})


def settled_horizon(horizon: float, found: Trajectory) -> float:
    """Return the horizon in s that a campaign requests, after a first rollout with `horizon`.

    A function may take no horizon and have a duration of its own, and a system may return one sample for any.
    """
    last = float(found.samples[-1, 0])
    return last if horizon == 0 or len(found.samples) == 1 else horizon


def score(specification: str | None, spec: SystemSpec) -> Score:
    """Return what a rollout is scored by: the robustness, or without a formula the least value of the first column.

    The function raises PerfboundError where the formula has no value.

    Raises:
        PerfboundError: the specification is no formula over the columns.

    """
    if specification is None:
        return lambda trajectory: float(trajectory.column(spec.columns[1].name).min())
    try:
        formula = parse_formula(specification, [column.name for column in spec.columns])
    except FormulaError as error:
        raise PerfboundError(f"--specification: {error}") from None

    def robust(trajectory: Trajectory) -> float:
        try:
            return scored(formula, trajectory, spec.after_end).robustness
        except ValueError as error:
            raise PerfboundError(f"--specification: {error}") from None

    return robust
