"""The rows that were added to a campaign database since the last call; nothing stays open between two calls."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import sqlalchemy as sa
from sqlalchemy import Connection

from ...schemas.errors import JournalError
from ...schemas.ids import RolloutId, rollout_at
from ...schemas.ranges import within_seconds
from ...schemas.result.block_facts import (
    BatchFact,
    BlockObservationFact,
    BlockProposalFact,
    each_rollout,
    each_violation,
)
from ...schemas.result.facts import (
    RECORDED,
    BoundFact,
    ExtensionFact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from ...schemas.values import Proposal
from . import tables
from .facts import READERS, rollout_fact
from .progress import ROLLOUTS_OF_WORKERS
from .read import read_header, reading
from .rows import DATABASE

T = TypeVar("T")

_SINCE: sa.BindParameter[int] = sa.bindparam("since")
_rollouts, _outcomes, _attempts = tables.rollouts.c, tables.outcomes.c, tables.attempts.c
# Outcomes and attempts have no sequence number: SQLite's row number grows with each insert, and no row is ever deleted.
_ENDED = sa.literal_column("outcomes.rowid", sa.Integer)
_STARTED = sa.literal_column("attempts.rowid", sa.Integer)
_DECISIONS = {
    table: sa.select(table).where(table.c.seq > _SINCE)
    for table in (tables.tests, tables.observations, tables.bounds, tables.extensions)
}
_LAST = sa.func.max(_rollouts.seq)
_COUNTS = (
    sa.select(_rollouts.problem, sa.func.sum(_rollouts.rollouts).label("number"), _LAST.label("seq"))
    .where(_rollouts.seq > _SINCE)
    .group_by(_rollouts.problem)
)
_WORKERS = sa.text(ROLLOUTS_OF_WORKERS).bindparams(recorded=RECORDED)
# The worker beside max(...) is that of its row, as in the query above: of what was recorded again the last one.
_IN_BATCHES = sa.text("""
    SELECT problem, test, variant, replicate, replicates, failures, worker, max(attempt) AS attempt, outcomes.ended
    FROM rollouts CROSS JOIN outcomes WHERE seq > :since AND rollouts < places AND outcome = :recorded
    AND rollout = problem || '.' || test || '.' || variant || '.' || replicate || '.' || places
    GROUP BY seq ORDER BY seq
""").bindparams(recorded=RECORDED)
_VIOLATIONS = sa.select(tables.rollouts).where(_rollouts.seq > _SINCE, _rollouts.robustness < 0).order_by(_rollouts.seq)
# A row has the rollouts of one test, or of the tests of a batch: a view of each test would expand every one of them.
_OF_TEST = (
    sa.select(tables.rollouts)
    .where(_rollouts.problem == sa.bindparam("problem"), _rollouts.test <= sa.bindparam("test"))
    .where(_rollouts.test + _rollouts.places / _rollouts.replicates > sa.bindparam("test"))
)
_PROPOSAL = (
    sa.select(tables.tests)
    .where(tables.tests.c.problem == sa.bindparam("problem"), tables.tests.c.test <= sa.bindparam("test"))
    .order_by(tables.tests.c.test.desc())
    .limit(1)
)
_OUTCOMES = sa.select(tables.outcomes, _ENDED.label("rowid")).where(_ENDED > _SINCE).order_by(_ENDED)
_HOSTS = (
    sa.select(_attempts.worker, _attempts.host, sa.func.max(_STARTED).label("rowid"))
    .where(_STARTED > _SINCE)
    .group_by(_attempts.worker, _attempts.host)
    .order_by(sa.literal_column("rowid"))
)
_RUN = sa.select(tables.campaign.c.run)


Decision = ProposalFact | BlockProposalFact | ObservationFact | BlockObservationFact | BoundFact | ExtensionFact


@dataclass(frozen=True, slots=True)
class AttemptOutcome:
    """The end of one attempt: `ended` is Unix time, the others are s."""

    rollout: str
    attempt: int
    worker: str
    outcome: str
    ended: float
    cpu_seconds: float
    wall_seconds: float
    kind: str | None = None
    """Of a failure: `schemas.failure.FailureKind`."""


@dataclass(frozen=True, slots=True)
class ComparedResult:
    """A result that was compared with another one of its rollout; `at` is Unix time."""

    kind: str
    """"compared", "outvoted", or "reviewed": simulated again because an outvoted worker had recorded it."""
    rollout: str
    attempt: int
    worker: str
    sha256: str
    at: float


@dataclass(frozen=True, slots=True)
class PauseChange:
    """The begin of a pause of a worker or host, or with 0 s its early end; `at` is Unix time, `seconds` may be inf."""

    kind: str
    name: str
    at: float
    seconds: float
    reason: str


@dataclass(frozen=True, slots=True)
class Session:
    """One run or resume."""

    host: str
    started: float
    """Unix time."""
    system: str | None
    """Reference of a system that is not installed."""
    revision: str | None
    """Of its folder, in a repository."""
    platform: str
    account: str | None
    """Name of the user who ran the orchestrator, if there is one."""
    options: str | None
    """Of a `perfbound resume` for the same workers, if there were any; JSON."""


_OUTCOME_FIELDS = tuple(each.name for each in fields(AttemptOutcome))


def _after_last(table: sa.Table, row: type) -> sa.Select[Any]:
    """Return the query of the entries of a table after the last one that was read."""
    columns = (table.c[each.name] for each in fields(row))
    return sa.select(table.c.entry, *columns).where(table.c.entry > _SINCE).order_by(table.c.entry)


_SESSIONS = sa.select(*(tables.sessions.c[each.name] for each in fields(Session))).order_by(tables.sessions.c.session)
_OPINIONS, _PAUSES = _after_last(tables.opinions, ComparedResult), _after_last(tables.set_aside, PauseChange)


@dataclass(frozen=True, slots=True)
class Changes:
    """The rows that one call found and the call before had not; `header` and `sessions` are whole.

    `decisions` are as they were written, those of blocks among them. `rollouts` counts by problem, `of_workers` by the
    worker that recorded them, `violations` are those with robustness below 0, `hosts` the last host by worker.
    """

    header: Header
    decisions: tuple[Decision, ...]
    rollouts: dict[str, int]
    of_workers: dict[str, int]
    violations: tuple[RolloutFact, ...]
    outcomes: tuple[AttemptOutcome, ...]
    hosts: dict[str, str]
    sessions: tuple[Session, ...]
    """All of them, in their order."""
    opinions: tuple[ComparedResult, ...] = ()
    pauses: tuple[PauseChange, ...] = ()

    @property
    def extended(self) -> bool:
        """Whether the campaign was extended."""
        return any(isinstance(fact, ExtensionFact) for fact in self.decisions)


class ChangeReader:
    """Reads a campaign in increments; used by one thread at a time."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._header: Header | None = None
        self._seq = self._ended = self._started = self._compared = self._paused = 0

    def read(self) -> Changes:
        """Return what was added, at one moment in time.

        Raises:
            JournalError: there is no campaign, it cannot be read, or it is another one than before.

        """
        seq = {"since": self._seq}
        # One snapshot for all tables: a bound is never seen without its observation.
        with reading(self._directory) as connection:
            header = self._checked(connection)
            decisions = [
                (row.seq, _fact(table, row, self._directory))
                for table, query in _DECISIONS.items()
                for row in connection.execute(query, seq)
            ]
            counts = connection.execute(_COUNTS, seq).all()
            of_workers = {row[0]: row[1] for row in connection.execute(_WORKERS, seq)}
            violations = connection.execute(_VIOLATIONS, seq).all()
            outcomes = connection.execute(_OUTCOMES, {"since": self._ended}).all()
            in_batches = connection.execute(_IN_BATCHES, seq).all() if header.config.batch > 1 else []
            hosts = connection.execute(_HOSTS, {"since": self._started}).all()
            sessions = connection.execute(_SESSIONS).all()
            opinions = connection.execute(_OPINIONS, {"since": self._compared}).all()
            pauses = connection.execute(_PAUSES, {"since": self._paused}).all()
        decisions.sort(key=lambda pair: pair[0])  # the sequence number is common to all tables of facts
        found = Changes(
            header,
            tuple(fact for _, fact in decisions),
            {row.problem: row.number for row in counts},
            of_workers,
            tuple(fact for row in violations for fact in _rollouts_of(row, self._directory, each_violation)),
            (*map(_ended_attempt, outcomes), *(each for row in in_batches for each in _failed_in_batch(row))),
            {row.worker: row.host for row in hosts},
            tuple(Session(*row) for row in sessions),
            tuple(ComparedResult(*row[1:]) for row in opinions),
            tuple(PauseChange(*row[1:]) for row in pauses),
        )
        # Only now: a call that fails half-way is repeated whole.
        self._header = header
        self._seq = max([self._seq, *(number for number, _ in decisions), *(row.seq for row in counts)])
        self._ended = max([self._ended, *(row.rowid for row in outcomes)])
        self._started = max([self._started, *(row.rowid for row in hosts)])
        self._compared = max([self._compared, *(row.entry for row in opinions)])
        self._paused = max([self._paused, *(row.entry for row in pauses)])
        return found

    def _checked(self, connection: Connection) -> Header:
        if self._header is None:
            return read_header(connection, self._directory)
        # Its sequence numbers start again: the increments of two campaigns must not be added up.
        if connection.execute(_RUN).scalar() != self._header.run:
            raise JournalError(f"{self._directory}: another campaign has taken the place of this one; open it anew")
        return self._header


def rollouts_of(directory: Path, problem: str, test: int) -> tuple[RolloutFact, ...]:
    """Return the recorded rollouts of one test, by variant and replicate.

    Raises:
        JournalError: there is no campaign, or it cannot be read.

    """
    with reading(directory) as connection:
        return rollouts_in(connection, directory, problem, test)


def rollouts_in(connection: Connection, directory: Path, problem: str, test: int) -> tuple[RolloutFact, ...]:
    """Return the same from an open database; raises as `rollouts_of`."""
    found = _near(connection, directory, problem, test)
    return tuple(sorted((fact for fact in found if fact.rollout.test == test), key=lambda fact: fact.rollout))


def batch_in(connection: Connection, directory: Path, fact: RolloutFact) -> tuple[RolloutFact, ...]:
    """Return the rollouts that share the file of a recorded one, in their order; raises as `rollouts_of`."""
    near = _near(connection, directory, fact.rollout.problem, fact.rollout.test)
    return tuple(each for each in near if each.path == fact.path)


def _near(connection: Connection, directory: Path, problem: str, test: int) -> Iterator[RolloutFact]:
    """Yield the rollouts of a test, and those that share a row with one of them."""
    rows = connection.execute(_OF_TEST, {"problem": problem, "test": test}).all()
    return (fact for row in rows for fact in _rollouts_of(row, directory))


def proposal_in(connection: Connection, directory: Path, problem: str, test: int) -> Proposal:
    """Return the proposal of a test that has a rollout, from an open database; raises as `rollouts_of`."""
    row = connection.execute(_PROPOSAL, {"problem": problem, "test": test}).one()
    fact = _fact(tables.tests, row, directory)
    proposed: ProposalFact = fact.of_test(test) if isinstance(fact, BlockProposalFact) else fact
    return proposed.proposal


def _failed_in_batch(row: Any) -> Iterator[AttemptOutcome]:
    """Yield the rollouts that failed in a recorded batch, each as an attempt of its own."""
    first = RolloutId(row.problem, row.test, row.variant, row.replicate)
    for place, reason in json.loads(row.failures):
        rollout = str(rollout_at(first, place, row.replicates))
        # The attempt at the batch has its seconds.
        yield AttemptOutcome(rollout, row.attempt, row.worker, str(reason), row.ended, 0.0, 0.0, "system")


def _ended_attempt(row: Any) -> AttemptOutcome:
    # An edited database may have any number of seconds: a sum of them would not be finite.
    seconds = {name: within_seconds(getattr(row, name)) for name in ("cpu_seconds", "wall_seconds")}
    return AttemptOutcome(**{name: getattr(row, name) for name in _OUTCOME_FIELDS} | seconds)


def _rollouts_of(
    row: Any, directory: Path, each: Callable[[RolloutFact | BatchFact], Iterator[RolloutFact]] = each_rollout
) -> tuple[RolloutFact, ...]:
    """Return the rollouts of a row, which may be that of a batch."""
    return _read(lambda row: tuple(each(rollout_fact(row))), tables.rollouts.name, row, directory)


def _fact(table: sa.Table, row: Any, directory: Path) -> Any:
    return _read(READERS[table.name], table.name, row, directory)


def _read(reader: Callable[[Any], T], table: str, row: Any, directory: Path) -> T:
    try:
        return reader(row)
    except (ValueError, TypeError) as error:
        raise JournalError(f"{directory / DATABASE}: table {table}: a row cannot be read ({error})") from None
