"""Read-only queries of a campaign database; they never disturb the orchestrator that writes it."""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from ...schemas.errors import JournalError
from ...schemas.facts import RECORDED, RESTORED, BoundFact, Header, ObservationFact, ProposalFact
from ...schemas.values import Bound, Observation, ProblemProgress, Proposal, StoppedBy
from . import tables
from .journal import DATABASE, READERS, existing, read_header
from .lock import is_held

LONGEST = 2**26
"""Bytes of one value."""
RECENT = 1000
MINUTE = 60.0
"""The rate is that of the last minute of work, or of its last `RECENT` rollouts."""

_tests, _rollouts, _bounds, _outcomes = tables.tests.c, tables.rollouts.c, tables.bounds.c, tables.outcomes.c
_ROLLOUTS = sa.select(_rollouts.problem, sa.func.count()).group_by(_rollouts.problem)
_BOUNDS = sa.select(tables.bounds, _tests.F).join_from(
    tables.bounds, tables.tests, (_bounds.problem == _tests.problem) & (_bounds.test == _tests.test)
)
_LAST_BOUNDS = _BOUNDS.where(
    _bounds.seq.in_(sa.select(sa.func.max(_bounds.seq)).group_by(_bounds.problem).scalar_subquery())
)
_WORKERS = (
    sa.select(_outcomes.worker, sa.func.count(), sa.func.max(_outcomes.ended))
    .where(_outcomes.outcome == RECORDED)
    .group_by(_outcomes.worker)
    .order_by(_outcomes.worker)
)
_FAILURES = sa.select(sa.func.count()).where(_outcomes.outcome.not_in([RECORDED, RESTORED]))
_RECENT = (
    sa.select(_outcomes.ended)
    .where(_outcomes.outcome == RECORDED)
    .order_by(sa.literal_column("outcomes.rowid").desc())
    .limit(RECENT)
)
_SESSIONS = sa.select(sa.func.count()).select_from(tables.sessions)


@dataclass(frozen=True, slots=True)
class CampaignProgress:
    """The state of a campaign, from its database alone."""

    header: Header
    problems: tuple[ProblemProgress, ...]
    """In the order of the campaign file."""
    workers: tuple[tuple[str, int, float], ...]
    """(worker, rollouts recorded, Unix time of the last one)."""
    failures: int
    sessions: int
    rate: float
    """Rollouts per second over the last minute of work, or over its last thousand rollouts."""


@dataclass(frozen=True, slots=True)
class ObservedTest:
    """The facts of one observed test, joined; all in terms of the maximised objective J."""

    test: int
    proposal: Proposal
    observation: Observation
    bound: Bound
    stopped_by: StoppedBy | None

    @classmethod
    def of(cls, proposal: ProposalFact, observation: ObservationFact, bound: BoundFact) -> "ObservedTest":
        """Join the three facts of a test."""
        return cls(bound.test, proposal.proposal, observation.observation, bound.bound, bound.stopped_by)


@contextmanager
def reading(directory: Path) -> Iterator[Connection]:
    """Open the database of a campaign read-only, at one moment in time.

    Raises:
        JournalError: there is none, or it cannot be read.

    """
    path = existing(directory).resolve()
    # Where nobody writes, a reader that did not say `immutable` would leave -wal and -shm beside the database.
    still = not is_held(directory) and not _size(path.with_name(f"{path.name}-wal"))
    try:
        with _engine(path, immutable=still).connect() as connection:
            connection.exec_driver_sql("BEGIN")  # the driver would begin before a write only
            yield connection
    except sa.exc.DatabaseError as error:
        raise JournalError(f"{directory / DATABASE}: cannot be read ({error.orig})") from None


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


@lru_cache(maxsize=16)
def _engine(path: Path, *, immutable: bool) -> Engine:
    """Return what opens a database and closes it again; kept, because it keeps the queries that it has compiled."""
    query = {"mode": "ro", "uri": "true"} | ({"immutable": "1"} if immutable else {})
    url = sa.URL.create("sqlite", database=f"file:{quote(str(path))}", query=query)
    engine = sa.create_engine(url, poolclass=sa.NullPool)
    sa.event.listen(engine, "connect", _distrust)
    return engine


def _distrust(connection: Any, _record: object) -> None:
    """Let a database that somebody made run nothing and fill no memory."""
    connection.execute("PRAGMA trusted_schema=OFF")
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)


def progress(directory: Path) -> CampaignProgress:
    """Return the progress of the campaign in `directory`.

    Raises:
        JournalError: there is none, or it cannot be read.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        rollouts = {str(row[0]): int(row[1]) for row in connection.execute(_ROLLOUTS)}
        last = {str(row.problem): row for row in connection.execute(_LAST_BOUNDS)}
        return CampaignProgress(
            header,
            tuple(_progress(last.get(each.name), rollouts.get(each.name, 0)) for each in header.config.problems),
            tuple((str(row[0]), int(row[1]), float(row[2])) for row in connection.execute(_WORKERS)),
            connection.execute(_FAILURES).scalar_one(),
            connection.execute(_SESSIONS).scalar_one(),
            rate(connection.execute(_RECENT).scalars().all()),
        )


def _progress(last: Any, rollouts: int) -> ProblemProgress:
    if last is None:
        return ProblemProgress(0, rollouts, None, None, None)
    fact = READERS[tables.bounds](last)
    assert isinstance(fact, BoundFact)
    return ProblemProgress(last.test + 1, rollouts, last.F, fact.bound, fact.stopped_by)


def history(directory: Path) -> dict[str, tuple[ObservedTest, ...]]:
    """Return the observed tests of every problem, in their order.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        return {problem.name: _observed(connection, problem.name) for problem in header.config.problems}


def _observed(connection: Connection, name: str) -> tuple[ObservedTest, ...]:
    by_test: list[dict[int, Any]] = []
    for table in (tables.tests, tables.observations, tables.bounds):
        rows = connection.execute(sa.select(table).where(table.c.problem == name).order_by(table.c.test))
        by_test.append({row.test: READERS[table](row) for row in rows})
    tests, seen, bounds = by_test
    return tuple(ObservedTest.of(tests[test], seen[test], bounds[test]) for test in bounds)


def rate(ended: Sequence[float]) -> float:
    """Return rollouts per second over the last minute before the newest of these Unix times."""
    newest = max(ended, default=0.0)
    minute = [time for time in ended if time > newest - MINUTE]
    return (len(minute) - 1) / (newest - min(minute)) if len(minute) > 1 and newest > min(minute) else 0.0
