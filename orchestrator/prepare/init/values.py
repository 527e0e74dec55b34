"""The first values of a campaign: the starts and scores of a pilot, and constants where none can be calibrated."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ....schemas.errors import PerfboundError
from ....schemas.file.defaults import derived_lengths
from ....schemas.system import Parameter, SystemSpec
from ....schemas.trajectory.trajectory import Trajectory
from ...campaign.objectives import scored
from ...mathematics.gp.kernels import Floats
from ...mathematics.search.goal import goal_of
from ...mathematics.stl.parser import FormulaError, parse_formula
from ...mathematics.stl.tree import columns, predicates
from ..calibrate.constants import Constant
from ..rounded import PARTS, rounded, rounded_up

if TYPE_CHECKING:
    from ....schemas.file.objectives import ProblemName


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
    constants: dict["ProblemName", tuple[Constant, ...]]
    """Of each problem, in the order of the file; empty where a claim needs none."""
    guess: str = ""
    """Ends the meaning of clip and constants that no pilot shows."""
    scale: Mapping[str, float] = field(default_factory=dict)
    """Of each column that a search compares with others, its usual range; empty where it compares none."""


Score = Callable[[Trajectory], float]
"""From a rollout to one number, of which more is better."""
CORNERS, INNER = 8, 16
"""Starts of a pilot at corners of the box, where a system is often at its worst, and in it."""
NOISY_ROLLOUTS = 2
"""Rollouts at each start where they depend on the seed."""
UNLIKE = 2.0
"""Quotient of two spans of columns from which on one hides the other."""
LEAST_SPAN, MOST_SPAN = 1e-9, 1e99
GUESSED_NORM = 4.0
"""B of a guess, in largest distances from the prior mean: those of a calibration are 2 to 15 of them."""


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
        formula = parse_formula(specification, spec.units)
    except FormulaError as error:
        raise PerfboundError(f"--specification: {error}") from None

    def robust(trajectory: Trajectory) -> float:
        try:
            return scored(formula, trajectory, spec.after_end).robustness
        except ValueError as error:
            raise PerfboundError(f"--specification: {error}") from None

    return robust


def search_scale(specification: str, spec: SystemSpec, spans: Mapping[str, float]) -> dict[str, float]:
    """Return the scale of each column for a search, from its span in a pilot: its next number of two digits.

    It is empty where no predicate can hide another one: where those inside each part of the formula have spans that
    differ by less than `UNLIKE`.
    """
    tree = parse_formula(specification, spec.units)
    # Of a column that never changed, or by no more than rounding, no range is known.
    known = {name: span for name, span in spans.items() if LEAST_SPAN < span < MOST_SPAN}
    scale = {name: rounded_up(known[name]) if name in known else 1.0 for name in sorted(columns(tree))}
    for part in goal_of(tree)[1]:
        found = [max(scale[name] for name in columns(each)) for each in predicates(part) if columns(each)]
        if found and max(found) > UNLIKE * min(found):
            return scale
    return {}


def guessed(values: Floats | None, *, noisy: bool, why: str) -> tuple[Constant, ...]:
    """Return constants to replace, from J of a few rollouts (n, k) or of none; `why` is the reason of each."""
    centre, furthest = 0.0, 10.0
    if values is not None:
        means = values.mean(axis=1)
        centre = rounded(float(means.mean()), float(np.ptp(means)) or abs(float(means[0])) or 1.0)
        furthest = float(np.abs(means - centre).max()) or abs(centre) or 1.0
    noise = Constant("noise_scale", "derived", "From the clip, which assumes nothing.")
    return (
        Constant("prior_mean", centre, why),
        Constant("rkhs_norm", rounded_up(GUESSED_NORM * furthest), why),
        noise if noisy else Constant("noise_scale", 0.0, "The rollouts do not depend on the seed."),
        Constant("alpha", rounded_up(furthest / PARTS), why),
    )
