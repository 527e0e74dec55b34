"""The facts of a campaign as rows with named columns and units, for pandas or a spreadsheet.

| table             | a row is                                                                       |
|-------------------|--------------------------------------------------------------------------------|
| `tests`           | a proposed test: its expectation, its observation, the bounds after it |
| `rollouts`        | a recorded rollout, its file, and the attempt that brought it                  |
| `observations`    | what one replicate contributed to an observed test, or to a requirement there  |
| `counterexamples` | a rollout with robustness below 0                                              |
| `failures`        | an attempt that failed, and whether it failed in the system                    |
| `opinions`        | a result that was compared, outvoted or simulated again                        |
| `set_aside`       | a pause of a worker or a host, or its early end                                |

Rows are in the order of the facts. Numbers are in the unit of their objective: for sense min they are robustness,
where the database has J = -robustness, also in the spot check. So `lower` is a bound from below and `upper` one from
above, in both senses.
"""

import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import sqlalchemy as sa
from sqlalchemy import Connection

from ...schemas.file.config import CampaignConfig
from ...schemas.file.disturbance import Disturbance
from ...schemas.file.drawn_claims import PROBABILITIES
from ...schemas.file.objectives import replicates_are_robustness
from ...schemas.file.parts import parts_of
from ...schemas.file.problem_models import Problem
from ...schemas.ids import CLOSING, RECHECK, RISK_CHECK, SPOT_CHECK, FileId, closing_check, rollout_at
from ...schemas.result.facts import NO_FAILURE, RECORDED, Header
from ...schemas.system import Parameter, SystemSpec
from ...schemas.values import DISCRETE
from . import tables

TABLES = ("tests", "rollouts", "observations", "counterexamples", "failures", "opinions", "set_aside")
BATCH = 1000
"""Rows that are fetched at a time."""

Kind = Literal["text", "integer", "number"]
Value = str | int | float | None
Row = tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class ExportColumn:
    """One column; `unit` is empty where there is none, or where it differs from row to row."""

    name: str
    kind: Kind = "number"
    unit: str = ""


@dataclass(frozen=True, slots=True)
class ExportTable:
    """One table: its columns, and how they follow from the database."""

    name: str
    columns: tuple[ExportColumn, ...]
    query: sa.Select[Any] | sa.CompoundSelect[Any]
    expand: Callable[[Any], Iterator[Row]]
    """Makes one or several rows of a row of the database."""

    def rows(self, connection: Connection) -> Iterator[Row]:
        """Yield all rows, a batch of them in memory."""
        # Not all at once: a campaign may have a million rollouts.
        for row in connection.execute(self.query, execution_options={"yield_per": BATCH}):
            yield from self.expand(row)


def export_table(name: str, header: Header) -> ExportTable:
    """Return one of `TABLES` of a campaign.

    Raises:
        KeyError: there is no such table.

    """
    match name:
        case "tests":
            return _tests_table(header)
        case "rollouts":
            return _rollouts_table(name, header, _ROLLOUTS)
        case "observations":
            return _observations_table(header)
        case "counterexamples":
            # Not of the recheck: it repeats rollouts that are listed.
            violating = _r.robustness < 0, _r.problem.not_like(f"{RECHECK}%")
            return _rollouts_table(name, header, _ROLLOUTS.where(*violating), violating_alone=True)
        case "failures":
            return _failures_table()
        case "opinions":
            return _as_stored(tables.opinions, _OPINION)
        case "set_aside":
            return _as_stored(tables.set_aside, _PAUSE)
    raise KeyError(name)


def robustness_unit(config: CampaignConfig, spec: SystemSpec) -> str:
    """Return the unit of the predicates; nothing if their columns have several, or are multiplied."""
    text = config.formula or ""
    words = set(re.findall(r"(?<![\w.])[A-Za-z_]\w*", text))
    units = {column.unit for column in spec.columns if column.name in words}
    # What is a number of steps, a product or the value of a function has none of these.
    other = units == {DISCRETE} or re.search(r"[*/^]|\b(sqrt|sin|cos|tan|exp|log)\b", text)
    return "" if len(units) != 1 or other else units.pop()


def unit(problem: Problem, config: CampaignConfig, spec: SystemSpec) -> str:
    """Return the unit of a problem's objective, or nothing if it is not known."""
    for claim in config.claims_of(problem)[:1]:
        return "" if claim.asked.quantity in PROBABILITIES else robustness_unit(config, spec)
    gap = config.gap_of(problem)
    column = gap.column if gap else problem.column
    units = {each.name: each.unit for each in spec.columns}
    return units.get(column, "") if column else robustness_unit(config, spec)


# tests

_t, _o, _b, _r = tables.each_test.c, tables.each_observation.c, tables.bounds.c, tables.rollouts.c
_TESTS = (
    sa.select(tables.each_test, _o.y, _b.upper, _b.lower, _b.stopped_by)
    .outerjoin(tables.each_observation, (_o.problem == _t.problem) & (_o.test == _t.test))
    .outerjoin(tables.bounds, (_b.problem == _t.problem) & (_b.test == _t.test))
    .order_by(_t.seq, _t.test)
)
_TEST = (ExportColumn("problem", "text"), ExportColumn("test", "integer"))
_OBJECTIVE = (ExportColumn("sense", "text"), ExportColumn("unit", "text"), ExportColumn("observation"))
_EXPECTED = (ExportColumn("mu"), ExportColumn("sigma"), ExportColumn("beta"), ExportColumn("F"))
_BOUNDS = (ExportColumn("lower"), ExportColumn("upper"), ExportColumn("stopped_by", "text"))


def _tests_table(header: Header) -> ExportTable:
    objectives = _objectives(header)

    def expand(row: Any) -> Iterator[Row]:
        sense, unit = objectives[closing_check(row.problem) or row.problem]
        y, mu, lower, upper = row.y, row.mu, row.lower, row.upper
        if sense == "min":
            y, mu, lower, upper = (_minus(value) for value in (y, mu, upper, lower))
        objective, expected = (sense, unit, y), (mu, row.sigma, row.beta, row.F)
        which = (row.problem, row.test, row.node, *json.loads(row.x))
        yield *which, *objective, *expected, lower, upper, row.stopped_by

    columns = (*_TEST, ExportColumn("node", "integer"), *_starts(header), *_OBJECTIVE, *_EXPECTED, *_BOUNDS)
    return ExportTable("tests", columns, _TESTS, expand)


# rollouts, counterexamples

_outcome, _tried = tables.outcomes.c, tables.attempts.c
_NAME = [sa.cast(each, sa.Text) for each in (_r.problem, _r.test, _r.variant, _r.replicate)]
_PLACES = sa.case((_r.seeds.is_(None), ""), else_="." + sa.cast(_r.places, sa.Text))
_TRIED = _NAME[0] + "." + _NAME[1] + "." + _NAME[2] + "." + _NAME[3] + _PLACES
"""What attempts call the rollout or the batch."""
_ATTEMPTS = sa.select(sa.func.count()).where(_tried.rollout == _TRIED).correlate(tables.rollouts).scalar_subquery()
_earlier = tables.outcomes.alias()
# After a discard there are two recorded attempts, and the present row is of the last one.
_LAST = (
    sa.select(sa.func.max(_earlier.c.attempt))
    .where(_earlier.c.rollout == _TRIED, _earlier.c.outcome == RECORDED)
    .correlate(tables.rollouts)
    .scalar_subquery()
)
_proposed = tables.tests.c
# A row for each rollout or batch: views would expand a million of them, also where none violates.
_ROLLOUTS = (
    sa.select(
        *(tables.rollouts, _proposed.test.label("first"), _proposed.tests, _proposed.x, _proposed.starts),
        *(_outcome.worker, _ATTEMPTS.label("attempts"), _outcome.wall_seconds, _outcome.cpu_seconds),
    )
    .join(tables.tests, (_proposed.problem == _r.problem) & (_proposed.test == _r.block))
    .outerjoin(
        tables.outcomes, (_outcome.rollout == _TRIED) & (_outcome.outcome == RECORDED) & (_outcome.attempt == _LAST)
    )
    .order_by(_r.seq)
)
_ROLLOUT = (
    ExportColumn("rollout", "text"),
    *_TEST,
    ExportColumn("variant", "text"),
    ExportColumn("replicate", "integer"),
    ExportColumn("seed", "integer"),
)
_REMARKS = (ExportColumn("by_tolerance", "integer"), ExportColumn("ended", unit="s"))
_FILE = (ExportColumn("path", "text"), ExportColumn("size", "integer", "B"), ExportColumn("sha256", "text"))
_ATTEMPT = (
    ExportColumn("worker", "text"),
    ExportColumn("attempts", "integer"),
    ExportColumn("wall", unit="s"),
    ExportColumn("cpu", unit="s"),
)


def _rollouts_table(name: str, header: Header, query: sa.Select[Any], *, violating_alone: bool = False) -> ExportTable:
    import numpy as np  # noqa: PLC0415  (late, as those that follow: other tables are written without it)

    from ...schemas.result.block_facts import each_rollout, each_violation  # noqa: PLC0415
    from .facts import rollout_fact  # noqa: PLC0415

    each, template = each_violation if violating_alone else each_rollout, header.template

    def expand(row: Any) -> Iterator[Row]:
        attempt = (row.worker, row.attempts, row.wall_seconds, row.cpu_seconds)
        of_block = row.starts is not None
        starts = np.frombuffer(row.starts).reshape(row.tests, -1).tolist() if of_block else [json.loads(row.x)]
        facts = list(each(rollout_fact(row)))
        # They follow from starts and seeds, as in the requests.
        places = [starts[fact.rollout.test - row.first] for fact in facts]
        drawn = template.disturbances(row.variant, places, [fact.seed for fact in facts]) if facts else ()
        for fact, values in zip(facts, drawn or [()] * len(facts), strict=True):
            which = (str(fact.rollout), *fact.rollout, fact.seed)
            found = (fact.robustness, int(fact.by_tolerance), fact.ended, fact.path, fact.size, fact.sha256)
            yield *which, *starts[fact.rollout.test - row.first], *values, *found, *attempt

    robustness = ExportColumn("robustness", unit=robustness_unit(header.config, header.spec))
    disturbances = declared_columns("disturbance", header.spec.disturbances, {*_TAKEN, *header.spec.as_parameters})
    columns = (*_ROLLOUT, *_starts(header), *disturbances, robustness, *_REMARKS, *_FILE, *_ATTEMPT)
    return ExportTable(name, columns, query, expand)


# failures

_FAILURE = (
    ExportColumn("rollout", "text"),
    ExportColumn("attempt", "integer"),
    ExportColumn("worker", "text"),
    ExportColumn("kind", "text"),
    ExportColumn("reason", "text"),
    ExportColumn("ended", unit="s"),
)


def _failures_table() -> ExportTable:
    # Outcomes have no sequence number: the order of the rows is that in which they were written.
    entry: sa.Label[int] = sa.literal_column("outcomes.rowid").label("entry")
    whole = sa.select(entry, tables.outcomes, sa.literal(1).label("replicates"), sa.null().label("failures"))
    in_batch = sa.select(entry, tables.outcomes, _r.replicates, _r.failures).join(
        tables.rollouts, (_outcome.rollout == _TRIED) & (_outcome.outcome == RECORDED) & (_r.rollouts < _r.places)
    )
    query = whole.where(_outcome.outcome.not_in(NO_FAILURE)).union_all(in_batch).order_by("entry")
    return ExportTable("failures", _FAILURE, query, _failure_row)


def _failure_row(row: Any) -> Iterator[Row]:
    if row.failures is None:
        yield row.rollout, row.attempt, row.worker, row.kind, row.outcome, row.ended
        return
    first = FileId.parse(row.rollout).rollout
    for place, reason in json.loads(row.failures):
        yield str(rollout_at(first, place, row.replicates)), row.attempt, row.worker, "system", reason, row.ended


# opinions, set_aside

_OPINION = (
    ExportColumn("kind", "text"),
    ExportColumn("rollout", "text"),
    ExportColumn("attempt", "integer"),
    ExportColumn("worker", "text"),
    ExportColumn("sha256", "text"),
    ExportColumn("at", unit="s"),
)
_PAUSE = (
    ExportColumn("kind", "text"),
    ExportColumn("name", "text"),
    ExportColumn("session", "integer"),
    ExportColumn("at", unit="s"),
    ExportColumn("seconds", unit="s"),
    ExportColumn("reason", "text"),
)


def _as_stored(table: sa.Table, columns: tuple[ExportColumn, ...]) -> ExportTable:
    """Return a table of the database as it is."""
    query = sa.select(*(table.c[each.name] for each in columns)).order_by(table.c.entry)
    return ExportTable(table.name, columns, query, lambda row: iter([tuple(row)]))


# observations

_OBSERVATIONS = sa.select(tables.each_observation).order_by(_o.seq, _o.test)
_REPLICATE = (ExportColumn("replicate", "integer"), ExportColumn("contribution"), ExportColumn("chain", "text"))


def _observations_table(header: Header) -> ExportTable:
    objectives = _objectives(header)
    robust = {each.name for each in header.config.problems if replicates_are_robustness(each.name, each.method)}
    config = header.config
    is_longer = bool(config.specifications or header.spec.reported)
    own = {each.name: config.replicates_of(each) for each in config.problems if is_longer}
    # Where each requirement is bounded, it has its replicates; else those of the whole specification come first. What
    # rollouts report comes last.
    names = [each.name for each in config.specifications] if parts_of(config) else []

    def parts(row: Any) -> Iterator[tuple[str | None, int, float]]:
        each, width = json.loads(row.each), own.get(row.problem)
        if width is None:
            yield from ((None, place, value) for place, value in enumerate(each))
            return
        for start, name in enumerate(names or [None]):
            yield from ((name, place, value) for place, value in enumerate(each[start * width : (start + 1) * width]))

    def expand(row: Any) -> Iterator[Row]:
        sense, unit = objectives[closing_check(row.problem) or row.problem]
        y = _minus(row.y) if sense == "min" else row.y
        turned = sense == "min" and row.problem not in robust
        for name, replicate, value in parts(row):
            part = _minus(value) if turned else value
            requirement = (name,) if names else ()
            yield row.problem, row.test, sense, unit, y, *requirement, replicate, part, row.chain

    requirement = (ExportColumn("requirement", "text"),) if names else ()
    return ExportTable("observations", (*_TEST, *_OBJECTIVE, *requirement, *_REPLICATE), _OBSERVATIONS, expand)


def _objectives(header: Header) -> dict[str, tuple[str, str]]:
    """Return sense and unit of every problem's objective.

    A spot check tests the objectives of the problems: with one of them, or several of one sense, it has theirs. Else
    its observations are J, and the other checks have no objective.
    """
    found = {
        problem.name: (header.config.sense_of(problem), unit(problem, header.config, header.spec))
        for problem in header.config.problems
    }
    same = set(found.values())
    tested = next(iter(same)) if len(same) == 1 else ("", "")
    return dict.fromkeys(CLOSING, ("", "")) | {SPOT_CHECK: tested, RISK_CHECK: tested} | found


def _starts(header: Header) -> tuple[ExportColumn, ...]:
    """Return the parameters."""
    return declared_columns("start", header.spec.parameters, _TAKEN)


def declared_columns(
    what: str, numbers: Iterable[Parameter | Disturbance], taken: Collection[str]
) -> tuple[ExportColumn, ...]:
    """Return the columns of numbers that a system declares; one called like a `taken` one gets a name that is free."""
    names = ((f"{what}_{each.name}" if each.name in taken else each.name, each.unit) for each in numbers)
    return tuple(ExportColumn(name, unit=unit) for name, unit in names)


_OURS = (*_ROLLOUT, *_FILE, *_ATTEMPT, *_OBJECTIVE, *_EXPECTED, *_BOUNDS, *_REPLICATE)
_TAKEN = {"node", "robustness", *(column.name for column in _OURS)}


def _minus(value: float | None) -> float | None:
    return None if value is None else 0.0 - value  # not -value: no -0.0
