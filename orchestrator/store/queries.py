"""Read-only views of a campaign database; they can never hurt the orchestrator that writes it."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from orchestrator.errors import JournalError
from orchestrator.store import tables
from orchestrator.store.journal import DATABASE, RECORDED, RESTORED, Header, existing, read_header
from orchestrator.store.lock import is_held


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
    still = not is_held(directory) and not path.with_name(f"{path.name}-wal").exists()
    try:
        with _engine(path, immutable=still).connect() as connection:
            connection.exec_driver_sql("BEGIN")  # the driver would begin before a write only
            yield connection
    except sa.exc.DatabaseError as error:
        raise JournalError(f"{directory / DATABASE}: cannot be read ({error.orig})") from None


@lru_cache(maxsize=16)
def _engine(path: Path, *, immutable: bool) -> Engine:
    """Return what opens a database and closes it again; kept, because it keeps the queries that it has compiled."""
    query = {"mode": "ro", "uri": "true"} | ({"immutable": "1"} if immutable else {})
    url = sa.URL.create("sqlite", database=f"file:{quote(str(path))}", query=query)
    return sa.create_engine(url, poolclass=sa.NullPool)


def progress(directory: Path) -> CampaignProgress:
    """Return how far the campaign in `directory` is."""
    with reading(directory) as connection:
        header = read_header(connection, directory)
        problems = tuple(_problem(connection, problem.name) for problem in header.config.problems)
        outcomes = tables.outcomes.c
        recorded = outcomes.outcome == RECORDED
        count, last = sa.func.count(), sa.func.max(outcomes.ended)
        workers = connection.execute(
            sa.select(outcomes.worker, count, last).where(recorded).group_by(outcomes.worker).order_by(outcomes.worker)
        ).all()
        failures = connection.execute(
            sa.select(count).select_from(tables.outcomes).where(outcomes.outcome.not_in((RECORDED, RESTORED)))
        ).scalar_one()
        sessions = connection.execute(sa.select(count).select_from(tables.sessions)).scalar_one()
        rate = _rate(connection)
    rows = tuple((str(row[0]), int(row[1]), float(row[2])) for row in workers)
    return CampaignProgress(header, problems, rows, failures, sessions, rate)


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


def _problem(connection: Connection, name: str) -> ProblemProgress:
    tests, rollouts, bounds = tables.tests, tables.rollouts, tables.bounds
    joined = bounds.join(tests, (bounds.c.problem == tests.c.problem) & (bounds.c.test == tests.c.test))
    last = connection.execute(
        sa.select(tests.c.F, bounds.c.upper, bounds.c.lower, bounds.c.stopped_by, bounds.c.test)
        .select_from(joined)
        .where(bounds.c.problem == name)
        .order_by(bounds.c.test.desc())
        .limit(1)
    ).first()
    count = sa.select(sa.func.count()).select_from(rollouts).where(rollouts.c.problem == name)
    recorded = connection.execute(count).scalar_one()
    if last is None:
        return ProblemProgress(name, 0, recorded, None, None, None, None)
    return ProblemProgress(name, last.test + 1, recorded, last.F, last.upper, last.lower, last.stopped_by)


def _rate(connection: Connection) -> float:
    outcomes = tables.outcomes.c
    query = sa.select(outcomes.ended).where(outcomes.outcome == RECORDED).order_by(sa.text("rowid DESC")).limit(1000)
    latest = query.cte()
    ended, newest = latest.c.ended, sa.select(sa.func.max(latest.c.ended)).scalar_subquery()
    minute = sa.select(sa.func.min(ended), sa.func.max(ended), sa.func.count()).where(ended > newest - 60)
    first, last, count = connection.execute(minute).one()
    return (count - 1) / (last - first) if count > 1 and last > first else 0.0
