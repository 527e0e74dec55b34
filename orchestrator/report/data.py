"""What report and live page show, as values; `page/` draws nothing else.

Numbers stand in the unit of their objective: for sense min they are robustness (J negated), for sense max J itself.
So `lower` <= truth <= `upper` holds in both, and `bound` is on the side that the certificate speaks of. Lists of one
series have equal lengths. A name or a path is text that a stranger may have chosen: the page never reads it as markup.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

State = Literal["running", "stopped", "finished"]
Series = tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of the certificate; the first one was chosen beforehand."""

    quantity: str
    """"rho_star" or "J_star"."""
    sense: str
    """">=" or "<="."""
    bound: float
    probability: float
    rule: str
    method: str
    sentence: str
    """The claim in words, with both numbers rounded so that they promise no more."""
    assumptions: tuple[str, ...]
    refuted: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Assumption:
    """One thing that the claims rest on."""

    id: str
    status: str
    """"derived", "assumed", "not refuted" or "refuted"."""
    detail: str


@dataclass(frozen=True, slots=True)
class Composition:
    """bound = nominal_bound - gap_term - risk_term: the bar from rho~ down to ell."""

    rule: str
    nominal_bound: float
    gap_term: float
    risk_term: float
    bound: float


@dataclass(frozen=True, slots=True)
class Axis:
    """One parameter of D."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Surface:
    """What is known of the objective over D: on a lattice of `shape` (last axis fastest), or at listed points.

    Of a box with more than two parameters it is the projection on the first two: the worst value over the others.
    """

    shape: tuple[int, ...] | None
    """None where D is a list of starts."""
    points: tuple[tuple[float, ...], ...]
    """The listed starts; empty for a lattice."""
    mean: Series
    lower: Series
    upper: Series
    worst: tuple[bool, ...]
    """Whether the worst start may still be here: the band does not rule it out."""
    band: str = ""
    """What `lower` and `upper` are, and with what probability, in words."""


@dataclass(frozen=True, slots=True)
class TestSeries:
    """The observed tests of a problem, column by column."""

    test: tuple[int, ...]
    x: tuple[tuple[float, ...], ...]
    y: Series
    distance: Series
    """F_i of method paper, U - L of the others; it goes down to alpha."""
    lower: Series
    upper: Series
    """The bounds that held after this test."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One optimisation problem."""

    name: str
    objective: str
    method: str
    sense: str
    """"min" or "max": the worst start is where the objective is least or greatest."""
    unit: str
    distance: str
    """What `Tests.distance` is: "F_i" or "U - L"."""
    alpha: float
    delta: float
    bound: float | None
    partner: float | None
    probability: float | None
    budget: int
    rollouts: int
    stopped_by: str | None
    left: str | None
    """Forecast of the tests left, in words."""
    surface: Surface | None
    tests: TestSeries


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve over time: a column of one rollout, thinned for the eye; its extremes are kept."""

    label: str
    variant: str
    """"nominal" or "true"."""
    column: str
    unit: str
    t: tuple[float, ...]
    values: tuple[float, ...]


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
    """Of its file, relative to the run directory."""
    command: str
    """What a person types to simulate it again."""


@dataclass(frozen=True, slots=True)
class RolloutsOfTest:
    """The rollouts of one test, as curves, and the limits that the specification puts on the column."""

    problem: str
    test: int
    traces: tuple[Curve, ...]
    limits: tuple[float, ...]
    rollouts: tuple[Rollout, ...]
    """The worst first, at most 24; the curves are those of the first few."""
    limit_columns: tuple[str, ...] = ()
    """The column of each limit."""
    error: str | None = None
    """What could not be read, in words; its curves are missing."""


@dataclass(frozen=True, slots=True)
class Worker:
    """One worker; state and heartbeat are known to a page only whose orchestrator tells them."""

    name: str
    host: str
    rollouts: int
    failures: int
    busy_seconds: float
    cpu_seconds: float
    last: float | None
    """Unix time of its last result."""
    state: str
    """"idle", "busy", "lost", ..., or "unknown"."""
    rollout: str | None
    heartbeat: float | None
    """Unix time."""


@dataclass(frozen=True, slots=True)
class Throughput:
    """Rollouts recorded over time."""

    rate: float
    """Rollouts per second over the last minute of work."""
    start: float | None
    """Unix time of the first result."""
    seconds: tuple[float, ...]
    recorded: tuple[int, ...]
    """`recorded[k]` rollouts stood in the database `seconds[k]` after the start; at most 200 points."""
    sessions: int
    failures: int


@dataclass(frozen=True, slots=True)
class ReportData:
    """Everything about a campaign that is worth a look, at one moment."""

    name: str
    seed: int
    run: str
    state: State
    updated: float | None
    """Unix time of this look; None in a report, which does not depend on the clock."""
    system: str
    doc: str
    specification: str | None
    horizon: float
    risk_weight: float
    clip: tuple[float, float] | None
    axes: tuple[Axis, ...]
    now: str
    """The bound that holds right now, in words; of a finished campaign its first claim."""
    claims: tuple[Claim, ...]
    composition: Composition | None
    assumptions: tuple[Assumption, ...]
    problems: tuple[Problem, ...]
    scenes: tuple[RolloutsOfTest, ...]
    """The worst test of each of the worst starts of every problem, the worst first; a live page asks for the others."""
    counterexamples: tuple[Rollout, ...]
    """Rollouts with robustness below 0, the worst first, at most `MOST`."""
    violations: int
    """How many there are."""
    rollouts: int
    workers: tuple[Worker, ...]
    throughput: Throughput
    software: Mapping[str, str]
    resume: str
    """What a person types to continue the campaign."""


def to_json(story: ReportData | RolloutsOfTest) -> str:
    """Return it as JSON that may stand inside a <script> element of a page.

    Raises:
        ValueError: a number is not finite.

    """
    text = json.dumps(_plain(asdict(story)), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _plain(value: Any) -> Any:
    """Round what is for eyes only to 7 digits: it halves the page."""
    if isinstance(value, float):
        return float(f"{value:.7g}") if abs(value) < 1e8 else value  # Unix times keep their seconds
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
