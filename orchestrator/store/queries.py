"""Read-only views of a campaign database; they can never hurt the orchestrator that writes it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import Connection

from orchestrator.errors import JournalError
from orchestrator.store import tables
from orchestrator.store.journal import DATABASE, Header, existing, read_header


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
    """Rollouts per second over the last minute of work."""


@contextmanager
def reading(directory: Path) -> Iterator[Connection]:
    """Open the database of a campaign read-only, at one moment in time.

    Raises:
        JournalError: there is none, or it cannot be read.

    """
    path = existing(directory).resolve()
    read_only = {"mode": "ro", "uri": "true"}
    engine = sa.create_engine(sa.URL.create("sqlite", database=f"file:{quote(str(path))}", query=read_only))
    try:
        with engine.connect() as connection:
            yield connection
    except sa.exc.DatabaseError as error:
        raise JournalError(f"{directory / DATABASE}: cannot be read ({error.orig})") from None
    finally:
        engine.dispose()


def progress(directory: Path) -> CampaignProgress:
    """Return how far the campaign in `directory` is."""
    with reading(directory) as connection:
        header = read_header(connection, directory)
        problems = tuple(_problem(connection, problem.name) for problem in header.config.problems)
        outcomes = tables.outcomes.c
        recorded = outcomes.outcome == "recorded"
        count, last = sa.func.count(), sa.func.max(outcomes.ended)
        workers = connection.execute(
            sa.select(outcomes.worker, count, last).where(recorded).group_by(outcomes.worker).order_by(outcomes.worker)
        ).all()
        failures = connection.execute(sa.select(count).select_from(tables.outcomes).where(~recorded)).scalar_one()
        sessions = connection.execute(sa.select(count).select_from(tables.sessions)).scalar_one()
        rate = _rate(connection)
    rows = tuple((str(row[0]), int(row[1]), float(row[2])) for row in workers)
    return CampaignProgress(header, problems, rows, failures, sessions, rate)


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
    ended = tables.outcomes.c.ended
    recorded = tables.outcomes.c.outcome == "recorded"
    newest = connection.execute(sa.select(sa.func.max(ended)).where(recorded)).scalar()
    if newest is None:
        return 0.0
    first, count = connection.execute(
        sa.select(sa.func.min(ended), sa.func.count()).where(recorded, ended > newest - 60)
    ).one()
    return (count - 1) / (newest - first) if newest > first else 0.0
