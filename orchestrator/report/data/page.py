"""The data of report and live page; `page/` draws nothing else, and the names of the fields are its JSON keys.

Numbers have the unit and the sign of their objective: robustness (J negated) for sense min, J itself for sense max.
So `lower` <= truth <= `upper` for both, and `bound` is the side of the certificate. Lists of one series have equal
lengths. Names and paths are untrusted text: the page never parses them as markup.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from pydantic import BaseModel

from ....schemas.file.objectives import Quantity
from ....schemas.result.certificate import CompositionTerms
from ....schemas.result.known import VerdictWord
from ...run.routers import RouterLink
from ...store.changes import ComparedResult
from .charts import ProblemCharts
from .claims import AssumptionRow, Claim, VerdictCard
from .rollouts import FoundCounterexample, RankedTest, Rollout, RolloutsOfTest, ViolatingStarts
from .workers import FailedAttempt, SetAsideRow, Throughput, WorkerRow

EXACT = {"bound", "partner", "probability", "limit", "nominal_bound", "gap_bound", "gap_term", "risk_term"}
"""Keys of single bounds and probabilities, which the page rounds to the safe side."""
SAFE_SIDE = {"lower": -1.0, "upper": 1.0}
"""Keys of series of bounds, and the direction that is safe."""
ROUND_OFF = 1e-10
"""A bound that is so near to a rounded number is this number; as in `outward`, which has four decimals."""

State = Literal["running", "stopped", "finished"]
Series = tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class Provenance:
    """The origin of a campaign; names are untrusted text."""

    accounts: tuple[str, ...]
    """Of the users who ran the orchestrator."""
    hosts: tuple[str, ...]
    """Of the orchestrator."""
    platforms: tuple[str, ...]
    started: float | None
    """Unix time of the first session."""
    ended: float | None
    """Unix time of the last result."""
    digest: str
    """SHA-256 of the campaign file in its canonical form."""
    file: str
    """The campaign file: all keys that differ from their defaults."""
    commit: str | None
    """Of the folder of a system that is not installed."""


@dataclass(frozen=True, slots=True)
class LiveCard:
    """The two rows of what holds, the progress bar, and the assumptions that were tested."""

    at: float
    """Unix time of these numbers."""
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    """Proven so far, and expected at the end; as many cells as `head`."""
    verdict: VerdictWord
    """If the campaign ended now."""
    ahead: VerdictWord | None
    """At the end; None while it is open."""
    reason: str
    """Why it is this verdict."""
    share: float
    """Of the work, from 0 to 1."""
    bar: str
    """The meaning of the share."""
    violations: str
    """How many rollouts violate the specification so far."""
    violated: bool
    tested: tuple[AssumptionRow, ...]
    """Refuted ones first."""
    others: tuple[str, ...]
    """Ids of those that only further claims rest on."""
    then: str
    """What a refutation leads to in this campaign."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One parameter of D."""

    name: str
    unit: str
    low: float
    high: float
    signal: str = ""
    """Of an input over time with many parameters its name: it is read as a curve, and not number by number."""


@dataclass(frozen=True, slots=True)
class DeclaredDisturbance:
    """One declared disturbance."""

    name: str
    unit: str
    law: str
    """In words."""


@dataclass(frozen=True, slots=True)
class Surface:
    """The band of a method at the nodes of a plane through D (last axis fastest), or at all listed starts."""

    axes: tuple[int, ...]
    """The parameters of the plane, one or two; all of them for listed starts."""
    through: tuple[float, ...]
    """A start in the plane: the node at the worst observed one. Empty for listed starts."""
    shape: tuple[int, ...] | None
    """None where D is a list of starts."""
    points: tuple[tuple[float, ...], ...]
    """The listed starts; empty for a plane."""
    mean: Series
    lower: Series
    upper: Series
    worst: tuple[bool, ...]
    """Whether the worst start may be at this node: the band does not rule it out."""
    band: str = ""
    """Meaning and probability of `lower` and `upper`, in words."""


@dataclass(frozen=True, slots=True)
class TestSeries:
    """Observed tests of a problem, column by column, in their order: all, or `MOST_TESTS` of more."""

    test: tuple[int, ...]
    x: tuple[tuple[float, ...], ...]
    y: Series
    distance: Series
    """F_i for method paper, U - L for the others; a problem converges when it reaches alpha."""
    lower: Series
    upper: Series
    """The bounds after this test."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A bound on the axis of a histogram."""

    name: str
    value: float
    sense: str
    """">=" or "<="."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """The robustness at drawn starts, the first rollout of each: a histogram, and the bounds so far."""

    requirement: str | None
    """None for the whole specification."""
    edges: tuple[float, ...]
    """Of the bars; 0 is one of them where it is inside."""
    counts: tuple[int, ...]
    violations: int
    zeros: int
    """Values that are exactly 0: they show neither, and count as violations."""
    unit: str
    marks: tuple[Mark, ...]
    failure: float | None
    """Bound of the probability of a violation, if it is claimed."""
    worst: int
    """The test with the least value."""
    least: float


@dataclass(frozen=True, slots=True)
class RegionSlice:
    """The regions in the plane of two parameters, or of the only one, as a raster over their ranges."""

    axes: tuple[int, ...]
    shape: tuple[int, ...]
    cells: str
    """A digit a pixel, last axis fastest: 0 safe, 1 unsafe, 2 undecided, or not one status."""
    through: tuple[float, ...]
    """The start that the plane goes through: the worst one that was observed."""


@dataclass(frozen=True, slots=True)
class RegionBox:
    """One certified box."""

    status: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    share: float


@dataclass(frozen=True, slots=True)
class RegionMap:
    """The division of the box by the proven sign of the objective."""

    safe: float
    unsafe: float
    undecided: float
    sentences: tuple[str, ...]
    slices: tuple[RegionSlice, ...]
    largest: tuple[RegionBox, ...]
    """Of each certified status, the largest first."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem."""

    name: str
    objective: str
    quantity: Quantity | None
    """Of its claim; None for a term of a composition."""
    method: str
    sense: str
    """"min" or "max": the worst start is where the objective is least or greatest."""
    unit: str
    distance: str
    """Name of `TestSeries.distance`: "F_i" or "U - L"."""
    alpha: float | None
    """The tolerance; None where the number of tests is fixed."""
    delta: float
    bound: float | None
    partner: float | None
    probability: float | None
    budget: int
    rollouts: int
    stopped_by: str | None
    left: str | None
    """Forecast of the remaining tests, in words."""
    outlook: str | None
    """Forecast of the bound at the end of the budget, and of what further rollouts would bring, in words."""
    surfaces: tuple[Surface, ...]
    """The plane of every two parameters, or the listed starts; empty where nothing is observed, or starts are drawn."""
    tests: TestSeries
    by_clip: float | None = None
    """What the clip alone proves of the objective; `bound` is never weaker."""
    warnings: tuple[str, ...] = ()
    """Constants that contradict each other or the data, in sentences."""
    clipped: tuple[float, float] | None = None
    """The clip that its words have to name; None where the clip hides nothing."""
    starts: int | None = None
    """Number of listed starts; None on a box."""
    drawn: Drawn | None = None
    """Where starts are drawn: `tests.y` is then the robustness, in the unit of this, whatever is bounded."""
    requirements: tuple[Drawn, ...] = ()
    """The same of each requirement, where there are several."""
    regions: RegionMap | None = None
    """Of a finished campaign with `regions`."""
    observed: int = 0
    """Number of observed tests; `tests` has a choice of very many."""
    requirement: str | None = None
    """The one that is bounded here on its own, from the tests of the problem; None for the whole specification."""
    charts: ProblemCharts = field(default_factory=ProblemCharts)
    refuted: bool = False
    """Whether the bound of a finished campaign rests on a refuted assumption."""

    @property
    def key(self) -> str:
        """Name of the problem, with that of the requirement behind it where there is one."""
        return self.name if self.requirement is None else f"{self.name}/{self.requirement}"


@dataclass(frozen=True, slots=True)
class ReportData:
    """All data of a campaign's report, at one moment."""

    name: str
    seed: int
    run: str
    state: State
    updated: float | None
    """Unix time of this refresh; None in a report, which does not depend on the clock."""
    system: str
    doc: str
    code: str | None
    """Where a system is that is not installed, and its revision."""
    specification: str | None
    horizon: float
    risk_weight: float | None
    """None where no claim is about the risk."""
    clip: tuple[float, float] | None
    axes: tuple[Axis, ...]
    now: str
    """The current bound in words; the first claim of a finished campaign."""
    claims: tuple[Claim, ...]
    composition: CompositionTerms | None
    assumptions: tuple[AssumptionRow, ...]
    checks: tuple[str, ...]
    """What the spot check and the recheck after the campaign showed, a sentence each."""
    problems: tuple[Problem, ...]
    scenes: tuple[RolloutsOfTest, ...]
    """Of every problem the worst test of each of the worst starts, the worst first, and the tests of `ranked`; as many
    as a report has room for. A live page requests the others."""
    counterexamples: tuple[Rollout, ...]
    """Rollouts with robustness below 0, the worst first, at most 1000."""
    violations: int
    """Number of all rollouts with robustness below 0."""
    later_violations: int
    """Those of them that checks after the campaign simulated, which `rollouts` does not count."""
    rollouts: int
    workers: tuple[WorkerRow, ...]
    throughput: Throughput
    software: Mapping[str, str]
    resume: str
    """Command that resumes the campaign."""
    failed_attempts: tuple[FailedAttempt, ...] = ()
    """The latest first, at most 50."""
    more_workers: int = 0
    """Workers without a row in `workers`, which has at most 100: those set aside, then those with most attempts."""
    counterexample: FoundCounterexample | None = None
    """Of a campaign that ends with the first one."""
    compared: tuple[ComparedResult, ...] = ()
    """The latest first, those that differ before all others, at most 50."""
    compared_results: int = 0
    """Number of all of them."""
    set_aside: tuple[SetAsideRow, ...] = ()
    """For good first, then the latest, at most 50."""
    verdict: VerdictCard | None = None
    """Of a finished campaign."""
    required: str = ""
    """What the campaign file requires of the first claim, in words."""
    closing_rollouts: Mapping[str, int] = field(default_factory=dict)
    """Rollouts of each check after the campaign, which `rollouts` does not count."""
    provenance: Provenance | None = None
    ranked: tuple[RankedTest, ...] = ()
    """The tests that a reader wants first; the first of them is shown. Empty where no rollout has a robustness."""
    violating: ViolatingStarts | None = None
    """The starts of all violations; None where there is none."""
    live: LiveCard | None = None
    """Of a campaign that has not ended."""
    link: RouterLink | None = None
    """To the router, on the live page of a run that has one."""
    disturbances: tuple[DeclaredDisturbance, ...] = ()
    """That the system declares, with the laws of the campaign."""
    where: str | None = None
    """The condition on the parameters, of a campaign that leaves out a part of the ranges."""


def to_json(data: ReportData | RolloutsOfTest) -> str:
    """Return the data as JSON that is safe inside a <script> element of a page.

    Raises:
        ValueError: a number is not finite.

    """
    text = json.dumps(_json_value(asdict(data)), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    # </script> and <!-- would end or change the element (HTML Living Standard, 4.12.1.3)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _json_value(value: Any, name: str = "") -> Any:
    """Return a value for json.dumps, numbers rounded to the 7 digits that a page can show: it halves the page.

    A bound that were rounded to the nearest here, and to the safe side on the page, could be stronger than the
    certificate: the few of `EXACT` keep all digits, and series of bounds are rounded to the safe side.
    """
    match value:
        case float():
            return value if name in EXACT or abs(value) >= 1e8 else _seven_digits(value, SAFE_SIDE.get(name))
        case BaseModel():
            return _json_value(value.model_dump())
        case dict():
            return {key: _json_value(each, key) for key, each in value.items()}
        case list() | tuple():
            return [_json_value(each, name) for each in value]
        case _:
            return value


def _seven_digits(value: float, side: float | None) -> float:
    """Return a number with 7 digits: the nearest one, or on a side.

    >>> _seven_digits(1.80669996, None), _seven_digits(1.80669996, -1.0), _seven_digits(0.25, -1.0)
    (1.8067, 1.806699, 0.25)
    """
    nearest = float(f"{value:.7g}")
    if side is None or side * (nearest - value) >= -ROUND_OFF:
        return nearest
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 6)
    return float(f"{nearest + side * unit:.7g}")
