"""The rollouts in the data of report and live page: curves, robustness over time, and violations by their starts."""

from dataclasses import dataclass
from typing import Literal

from ....schemas.file.signals import SignalKind

Rank = Literal["worst", "first violation", "median", "best"]


@dataclass(frozen=True, slots=True)
class Curve:
    """A column of one rollout over time, or an expression of the specification; thinned, its extremes are kept."""

    label: str
    variant: str
    """"nominal" or "true"."""
    column: str
    unit: str
    t: tuple[float, ...]
    values: tuple[float, ...]
    rollout: str = ""
    """Its id; empty for a curve that was simulated for the report."""


@dataclass(frozen=True, slots=True)
class DrawnRollout:
    """One rollout with curves: its identity, its robustness over time, and the moment that decides it."""

    id: str
    variant: str
    replicate: int
    seed: int
    robustness: float | None
    t: tuple[float, ...] = ()
    """Times of `margin`, thinned; empty where the specification has no robustness."""
    margin: tuple[float, ...] = ()
    """What `RolloutsOfTest.margin_of` names, at these times."""
    moment: tuple[float, float] | None = None
    """The stretch of time in which the robustness is attained; None where it is not one stretch."""
    columns: tuple[str, ...] = ()
    """Those that the deciding predicates read, and what these compare."""
    failed_at: float | None = None
    """When it ended early, in s, of a system that counts this as a violation: then `margin` is not what decides."""


@dataclass(frozen=True, slots=True)
class InputCurve:
    """An input signal of a start over time, as the system gets it."""

    name: str
    unit: str
    kind: SignalKind
    t: tuple[float, ...]
    values: tuple[float, ...]
    knots: tuple[float, ...]
    """The times of its knots."""
    low: float
    high: float
    """The range of its knots."""


@dataclass(frozen=True, slots=True)
class DrawnValue:
    """The value of one declared disturbance in one rollout, and how far out it is under its law."""

    place: int
    """Its number among the disturbances of the report."""
    value: float
    sd: float | None
    """The normal quantile of its probability: of a normal law its distance from the mean in standard deviations."""
    chance: float | None
    """Of one of finitely many values, its probability in place of this."""


@dataclass(frozen=True, slots=True)
class Rollout:
    """One recorded rollout."""

    id: str
    problem: str
    test: int
    variant: str
    replicate: int
    seed: int
    x: tuple[float, ...]
    robustness: float | None
    path: str
    """Path of its file relative to the run directory; empty if the recorded one leaves it."""
    command: str
    """Command that simulates it again."""
    disturbances: tuple[DrawnValue, ...] = ()
    """The few that are furthest out, the furthest first."""


@dataclass(frozen=True, slots=True)
class RolloutsOfTest:
    """The rollouts of one test as curves, with the limits that the specification sets for their columns."""

    problem: str
    test: int
    traces: tuple[Curve, ...]
    limits: tuple[float, ...]
    rollouts: tuple[Rollout, ...]
    """The worst first, at most 24; only the first few have curves."""
    limit_columns: tuple[str, ...] = ()
    """The column of each limit, or the expression."""
    error: str | None = None
    """Files that could not be read, in words; their curves are missing."""
    inputs: tuple[InputCurve, ...] = ()
    """The input signals of the test's start."""
    drawn: tuple[DrawnRollout, ...] = ()
    """The rollouts of `traces`, the worst first."""
    margin_of: str = ""
    """The formula that is evaluated at each moment; empty where there is none."""
    attained: str = ""
    """Which value of `DrawnRollout.margin` is the robustness: "least", "greatest" or "first"."""
    margin_unit: str = ""
    further: tuple[Curve, ...] = ()
    """The curves of `further_columns`, of which there may be fewer points; a live page requests them."""
    further_columns: tuple[str, ...] = ()
    """Recorded columns that the problem does not read, at most 40."""
    more_columns: int = 0
    """Recorded columns beyond these."""
    x: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class FoundCounterexample:
    """The rollout that ended a campaign because it violates the specification."""

    problem: str
    test: int
    sentences: tuple[str, ...]
    """Its start, seed and robustness in words; also what followed it, if that was sought."""
    command: str
    """Command that simulates it again."""


@dataclass(frozen=True, slots=True)
class RankedTest:
    """A test that has the worst, the median or the best rollout of the tested variant, or its first violation."""

    rank: Rank
    problem: str
    """Or the closing check."""
    test: int
    rollout: str
    robustness: float
    variant: str
    of: int
    """Number of all rollouts of the variant."""


@dataclass(frozen=True, slots=True)
class ViolatingStart:
    """A start with rollouts that violate the specification."""

    x: tuple[float, ...]
    violations: int
    rollouts: int
    """All of this start, of both variants."""
    worst: float
    problem: str
    """Problem and test of the worst one."""
    test: int


@dataclass(frozen=True, slots=True)
class StartGroup:
    """Violating starts near each other, the worst first, and the least box that contains them."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    starts: tuple[ViolatingStart, ...]
    violations: int
    rollouts: int
    worst: float


@dataclass(frozen=True, slots=True)
class ViolatingStarts:
    """All violations by their starts: groups of the worst starts, the worst first, and counts of all others."""

    groups: tuple[StartGroup, ...]
    starts: int
    """Number of all violating starts."""
    near: float
    """Two starts are near if they differ by at most this share of its range in each parameter."""
    other_starts: int = 0
    other_violations: int = 0
    other_rollouts: int = 0
