"""Values that campaign and mathematics exchange, in terms of the maximised objective J; the standard library only.

These classes are all that the mathematics imports of perfbound; the facts of a campaign contain them.
"""

import math
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["converged", "refuted", "counterexample"]
Stamps = Literal["exact", "float32", "accumulated"]
"""Times of samples: numbers of a step, rounded to float32, or sums with the round-off of every step."""
SampledQuantity = Literal["failure_probability", "quantile", "cvar", "mean", "risk", "share_of_starts", "next_rollout"]
"""The subject of a claim about drawn starts."""
DistributionName = Literal["uniform", "normal", "lognormal", "triangular", "weibull"]
FORMULA_FUNCTIONS = ("abs", "max", "min", "sqrt", "sin", "cos", "tan", "exp", "log")
FORMULA_WORDS = frozenset(
    {
        *("not", "and", "or", "implies", "inf", *FORMULA_FUNCTIONS),
        *("always", "eventually", "until", "until_from", "next"),
        *("historically", "once", "since", "previous", "rise", "fall"),
    }
)
"""Words of specifications, which name no column."""
Beyond = Literal["refuse", "truncate"]
"""A window beyond the end of a trajectory: the formula is refused, or the window has the samples that are there."""
DISCRETE = "discrete"
"""Unit of a column whose values are whole numbers, such as a gear: specifications compare it with == and !=."""
StoppedBy = Literal["converged", "budget", "refuted", "counterexample"]


@dataclass(frozen=True, slots=True)
class Proposal:
    """The next test: its candidate, and the numbers that chose it.

    `x` (p,) has the parameters' units, `mu` and `F` the unit of J. The first test of a problem has no `beta` and no
    `F`, and only method `paper` has an `F`. With refinement `x` need not be the node, but is within one cell of it.
    """

    node: int
    x: tuple[float, ...]
    mu: float | None
    sigma: float | None
    beta: float | None
    F: float | None

    def __post_init__(self) -> None:
        """Drop the signs of zeros."""
        _drop_signs_of_zeros(self, "mu", "sigma", "beta", "F")


@dataclass(frozen=True, slots=True)
class Observation:
    """y of a test, and the contribution of each replicate to it, in the order of the replicates.

    `each` has the values of J whose mean is y; in methods `scenario` and `sample`, and for the sample risk of method
    `paper`, it has the robustness. In method `sample` that of each requirement follows, where there are several. Last,
    where rollouts report disturbances and a control takes them, are the values that each replicate reports.
    """

    y: float
    each: tuple[float, ...]

    def __post_init__(self) -> None:
        """Drop the sign of a zero."""
        _drop_signs_of_zeros(self, "y")


@dataclass(frozen=True, slots=True)
class Bound:
    """lower <= max J <= upper; None where the method has no bound (yet)."""

    upper: float | None
    lower: float | None
    verdict: Verdict | None

    def __post_init__(self) -> None:
        """Drop the signs of zeros."""
        _drop_signs_of_zeros(self, "upper", "lower")


@dataclass(frozen=True, slots=True)
class Band:
    """The values of J that a method allows at each of its m candidates, unit J; NaN where it has no bound."""

    mean: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    possible: tuple[bool, ...]
    """Whether the maximum may still be at this candidate."""


def distance_after(bound: Bound, last_f: float | None) -> float | None:
    """Return the number that has to fall to alpha: F_i in method paper, which alone has one, else upper - lower.

    >>> distance_after(Bound(0.5, 0.2, None), None), distance_after(Bound(0.5, None, None), 0.1)
    (0.3, 0.1)
    """
    if last_f is not None:
        return last_f
    return None if bound.upper is None or bound.lower is None else bound.upper - bound.lower


MARKED = frozenset(math.ceil(1.1**power) for power in range(150))
"""Numbers of tests after which the course of a bound is kept: about 24 for each factor of ten, up to a million."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A guess of J, and its range."""

    middle: float
    low: float
    high: float

    def ends(self, sign: int) -> tuple[float, float]:
        """Return the ends of the range in the unit of the objective, which is J times `sign`; the lower one first."""
        return (self.low, self.high) if sign > 0 else (-self.high, -self.low)

    def words(self, sign: int) -> str:
        """Return the guess with its range, in the unit of the objective."""
        low, high = self.ends(sign)
        return f"{sign * self.middle:.3g} ({low:.3g} to {high:.3g})"


@dataclass(frozen=True, slots=True)
class ProblemProgress:
    """The state of one problem: its closed tests, their rollouts and the last bound; `F` is that of the last test.

    `extended` is the budget that an extension of the campaign gave it; None where it has that of the campaign file.
    """

    tests: int
    rollouts: int
    F: float | None
    bound: Bound | None
    stopped_by: StoppedBy | None
    extended: int | None = None
    course: tuple[tuple[int, float, float | None], ...] = ()
    """(tests, bound on J after them, distance to the tolerance then) at the tests that are `MARKED`."""
    planned: tuple[Guess, Guess] | None = None
    """Of a method that plans its tests: the bound at the end of the budget, and what a longer plan would gain."""


def _drop_signs_of_zeros(value: object, *names: str) -> None:
    # A column of SQLite keeps no -0.0: a hash chain over one would break when the campaign is read again.
    for name in names:
        if getattr(value, name) == 0.0:
            object.__setattr__(value, name, 0.0)
