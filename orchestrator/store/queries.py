"""Read-only views of a campaign database; they can never hurt the orchestrator that writes it."""

import json
import sqlite3
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from orchestrator.errors import JournalError
from orchestrator.store import tables
from orchestrator.store.journal import DATABASE, RECORDED, RESTORED, Header, existing, read_header
from orchestrator.store.lock import is_held

LONGEST = 2**26
"""Bytes of one value."""
RECENT = 1000
MINUTE = 60.0
"""The rate is that of the last minute of work, or of its last `RECENT` rollouts."""

_SINCE: sa.BindParameter[int] = sa.bindparam("since")
_tests, _rollouts, _bounds, _outcomes = tables.tests.c, tables.rollouts.c, tables.bounds.c, tables.outcomes.c
_ROWID = sa.literal_column("outcomes.rowid", sa.Integer)
_NEW_ROLLOUTS = (
    sa.select(_rollouts.problem, sa.func.count().label("number"), sa.func.max(_rollouts.seq).label("seq"))
    .where(_rollouts.seq > _SINCE)
    .group_by(_rollouts.problem)
)
_NEWEST = sa.select(sa.func.max(_bounds.seq)).where(_bounds.seq > _SINCE).group_by(_bounds.problem).scalar_subquery()
_NEWEST_BOUNDS = (
    sa.select(tables.bounds, _tests.F)
    .join_from(tables.bounds, tables.tests, (_bounds.problem == _tests.problem) & (_bounds.test == _tests.test))
    .where(_bounds.seq.in_(_NEWEST))
)
_NEW_OUTCOMES = (
    sa.select(
        _outcomes.worker,
        _outcomes.outcome,
        sa.func.count().label("number"),
        sa.func.max(_outcomes.ended).label("ended"),
        sa.func.max(_ROWID).label("rowid"),
    )
    .where(_ROWID > _SINCE)
    .group_by(_outcomes.worker, _outcomes.outcome)
)
_RECENT = (
    sa.select(_outcomes.ended)
    .where(_ROWID > _SINCE, _outcomes.outcome == RECORDED)
    .order_by(_ROWID.desc())
    .limit(RECENT)
)
_SESSIONS = sa.select(sa.func.count()).select_from(tables.sessions)


@dataclass(frozen=True, slots=True)
class ProblemProgress:
    """How far one problem is."""

    problem: str
    tests: int
    rollouts: int
    last_F: float | None  # noqa: N815  (the paper's symbol)
    upper: float | None
    lower: float | None
    stopped_by: str | None


@dataclass(frozen=True, slots=True)
class CampaignProgress:
    """How far a campaign is, as its database tells."""

    header: Header
    problems: tuple[ProblemProgress, ...]
    workers: tuple[tuple[str, int, float], ...]
    """(worker, rollouts recorded, Unix time of the last one)."""
    failures: int
    sessions: int
    rate: float
    """Rollouts per second over the last minute of work, or over its last thousand rollouts."""


@dataclass(frozen=True, slots=True)
class ObservedTest:
    """One observed test, and what its method said after it; all in terms of the maximised objective J."""

    test: int
    x: tuple[float, ...]
    """Shape (p,), units of the parameters."""
    y: float
    F: float | None
    upper: float | None
    lower: float | None
    stopped_by: str | None


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


class Watch:
    """A campaign that somebody looks at again and again: a look reads what was added since the last one.

    Nothing stays open between two looks: a connection that did would leave -wal and -shm beside a finished database.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._header: Header | None = None
        self._seq = self._ended = 0
        self._rollouts: Counter[str] = Counter()
        self._last: dict[str, Any] = {}
        self._workers: dict[str, tuple[int, float]] = {}
        self._failures = 0
        self._recent: deque[float] = deque(maxlen=RECENT)

    def look(self) -> CampaignProgress:
        """Return how far the campaign is now.

        Raises:
            JournalError: there is no campaign in the directory, or it cannot be read.

        """
        with reading(self._directory) as connection:
            if self._header is None:  # it never changes: the tables are insert-only
                self._header = read_header(connection, self._directory)
            self._count_facts(connection)
            self._count_outcomes(connection)
            sessions = connection.execute(_SESSIONS).scalar_one()
        problems = tuple(self._problem(problem.name) for problem in self._header.config.problems)
        workers = tuple((name, *found) for name, found in sorted(self._workers.items()))
        return CampaignProgress(self._header, problems, workers, self._failures, sessions, rate(self._recent))

    def _count_facts(self, connection: Connection) -> None:
        since = {"since": self._seq}
        for row in connection.execute(_NEW_ROLLOUTS, since):
            self._rollouts[row.problem] += row.number
            self._seq = max(self._seq, row.seq)
        for row in connection.execute(_NEWEST_BOUNDS, since):
            self._last[row.problem] = row
            self._seq = max(self._seq, row.seq)

    def _count_outcomes(self, connection: Connection) -> None:
        since = {"since": self._ended}
        self._recent.extend(reversed(connection.execute(_RECENT, since).scalars().all()))
        for row in connection.execute(_NEW_OUTCOMES, since):
            self._ended = max(self._ended, row.rowid)
            if row.outcome == RECORDED:
                count, last = self._workers.get(row.worker, (0, 0.0))
                self._workers[row.worker] = (count + row.number, max(last, row.ended))
            elif row.outcome != RESTORED:
                self._failures += row.number

    def _problem(self, name: str) -> ProblemProgress:
        last = self._last.get(name)
        if last is None:
            return ProblemProgress(name, 0, self._rollouts[name], None, None, None, None)
        return ProblemProgress(
            name, last.test + 1, self._rollouts[name], last.F, last.upper, last.lower, last.stopped_by
        )


def progress(directory: Path) -> CampaignProgress:
    """Return how far the campaign in `directory` is.

    Raises:
        JournalError: there is none, or it cannot be read.

    """
    return Watch(directory).look()


def history(directory: Path) -> dict[str, tuple[ObservedTest, ...]]:
    """Return the observed tests of every problem, in their order.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        return {problem.name: _observed(connection, problem.name) for problem in header.config.problems}


def _observed(connection: Connection, name: str) -> tuple[ObservedTest, ...]:
    tests, seen, bounds = tables.tests.c, tables.observations.c, tables.bounds.c
    joined = tables.tests.join(tables.observations, (seen.problem == tests.problem) & (seen.test == tests.test))
    joined = joined.join(tables.bounds, (bounds.problem == tests.problem) & (bounds.test == tests.test))
    columns = (tests.test, tests.x, seen.y, tests.F, bounds.upper, bounds.lower, bounds.stopped_by)
    rows = connection.execute(sa.select(*columns).select_from(joined).where(tests.problem == name).order_by(tests.test))
    return tuple(ObservedTest(row.test, tuple(json.loads(row.x)), *row[2:]) for row in rows)


def rate(ended: Sequence[float]) -> float:
    """Return rollouts per second over the last minute before the newest of these Unix times."""
    newest = max(ended, default=0.0)
    minute = [time for time in ended if time > newest - MINUTE]
    return (len(minute) - 1) / (newest - min(minute)) if len(minute) > 1 and newest > min(minute) else 0.0
