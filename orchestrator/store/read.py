"""Read-only queries of a campaign database, also beside the orchestrator that writes it."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from ...schemas.failure import Failure
from ...schemas.ids import Attempt, RolloutId, WorkId, parse_work, series_order
from ...schemas.result.facts import (
    HANDED_BACK,
    RECORDED,
    Header,
)
from . import tables
from .damage import naming_cause
from .readonly import is_still, open_readonly
from .rows import check_version, checked_header, existing, work_name


@contextmanager
def reading(directory: Path) -> Iterator[Connection]:
    """Open the database of a campaign read-only, at one moment in time.

    Raises:
        JournalError: there is none, it is of another schema version, or it is damaged.
        OSError: the disk is full or fails.

    """
    with reading_untrusted(directory) as connection:
        check_schema(connection, directory)
        yield connection


@contextmanager
def reading_untrusted(directory: Path) -> Iterator[Connection]:
    """Open a database as `reading` does, without a query: its tables may be anything.

    Raises:
        JournalError: there is none, or it is damaged.
        OSError: the disk is full or fails.

    """
    path = existing(directory).resolve()
    with naming_cause(directory), _reading_engine(path, immutable=is_still(directory, path)).connect() as connection:
        connection.exec_driver_sql("BEGIN")  # one snapshot; the driver would begin before a write only
        yield connection


@lru_cache(maxsize=16)
def _reading_engine(path: Path, *, immutable: bool) -> Engine:
    """Return the engine of a database; kept, because it keeps the queries that it has compiled."""
    # NullPool: an open connection would keep -wal and -shm beside a database that is closed meanwhile.
    return sa.create_engine(
        "sqlite://", creator=partial(open_readonly, path, immutable=immutable), poolclass=sa.NullPool
    )


def check_schema(connection: Connection, directory: Path) -> None:
    """Refuse a database of another schema version.

    Raises:
        JournalError: this perfbound does not read it.

    """
    check_version(directory, connection.execute(sa.select(tables.schema.c.version)).scalar())


def read_header(connection: Connection, directory: Path) -> Header:
    """Return the first fact.

    Raises:
        JournalError: the header is missing or was changed.

    """
    return checked_header(directory, connection.execute(sa.select(tables.campaign).limit(2)).all())


def stored_header(directory: Path) -> Header:
    """Return the first fact of the campaign in `directory`.

    Raises:
        JournalError: there is no campaign, or it cannot be read.

    """
    with reading(directory) as connection:
        return read_header(connection, directory)


def system_reference(directory: Path) -> str:
    """Return the system of a campaign as a worker finds it: its name, or its file as the last session had it.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        if header.config.system.kind == "name":
            return header.spec.name
        found = _of_last_session(connection, tables.sessions.c.system)
        if found is None and header.spec.repeated == "nowhere":
            return header.spec.name  # nothing is loaded of it
        return str(found or header.config.system.reference(directory / f"{header.config.name}.toml"))


def system_revision(directory: Path) -> str | None:
    """Return the commit of the folder of a system in a file, as the last session had it; None where git knew none.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        found = _of_last_session(connection, tables.sessions.c.revision)
    return None if found is None else str(found)


def _of_last_session(connection: Connection, column: sa.Column[Any]) -> object:
    """Return what the last session with a value has in a column; None without one."""
    newest = sa.select(column).where(column.is_not(None)).order_by(tables.sessions.c.session.desc())
    return connection.execute(newest.limit(1)).scalar()


def attempts(directory: Path) -> dict[WorkId, int]:
    """Return the highest attempt number of every rollout, or batch.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    columns = tables.attempts.c
    query = sa.select(columns.rollout, sa.func.max(columns.attempt)).group_by(columns.rollout)
    with reading(directory) as connection:
        return {parse_work(rollout): number for rollout, number in connection.execute(query)}


def last_outcome(directory: Path) -> float | None:
    """Return the Unix time at which the last attempt of the campaign ended; None without any.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        found = connection.execute(sa.select(sa.func.max(tables.outcomes.c.ended))).scalar()
    return None if found is None else float(found)


@dataclass(frozen=True, slots=True)
class EndedAttempt:
    """An attempt that failed; without a name of its host if its start was lost in a crash."""

    attempt: Attempt
    worker: str
    host: str
    failure: Failure


def failures(directory: Path) -> list[EndedAttempt]:
    """Return the failed attempts of the rollouts without a result, the oldest first.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    ended, began = tables.outcomes.c, tables.attempts.c
    recorded = sa.select(ended.rollout).where(ended.outcome == RECORDED)
    both = tables.outcomes.outerjoin(
        tables.attempts, (ended.rollout == began.rollout) & (ended.attempt == began.attempt)
    )
    columns = (ended.rollout, ended.attempt, ended.worker, began.host, ended.kind, ended.outcome)
    query = sa.select(*columns).select_from(both).where(ended.kind.is_not(None), ended.rollout.not_in(recorded))
    with reading(directory) as connection:
        rows = connection.execute(query.order_by(ended.ended)).all()
    return [
        EndedAttempt(Attempt(parse_work(rollout), number), worker, host or "", Failure(kind, reason))
        for rollout, number, worker, host, kind, reason in rows
    ]


def hand_backs(directory: Path) -> dict[WorkId, int]:
    """Return how often each rollout without a result was handed back; those that never were are absent.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    columns = tables.outcomes.c
    recorded = sa.select(columns.rollout).where(columns.outcome == RECORDED)
    query = sa.select(columns.rollout, sa.func.count()).where(columns.outcome == HANDED_BACK)
    query = query.where(columns.rollout.not_in(recorded)).group_by(columns.rollout)
    with reading(directory) as connection:
        return {parse_work(rollout): number for rollout, number in connection.execute(query)}


def irreproducible(directory: Path) -> int:
    """Return how many recorded rollouts have an attempt that failed in the system, so that a retry chose their outcome.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    columns = tables.outcomes.c
    recorded = sa.select(columns.rollout).where(columns.outcome == RECORDED)
    failed: sa.ColumnElement[bool] = columns.kind == "system"
    query = sa.select(sa.func.count(columns.rollout.distinct())).where(failed, columns.rollout.in_(recorded))
    with reading(directory) as connection:
        return connection.execute(query).scalar_one()


def contradicted(directory: Path) -> list[str]:
    """Return the rollouts of outvoted workers that had another result when they were simulated again.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    seen, rollouts = tables.opinions.c, tables.rollouts.c
    with reading(directory) as connection:
        query = sa.select(seen.rollout, seen.sha256).where(seen.kind == "reviewed")
        reviewed = connection.execute(query).all()
        if not reviewed:
            return []
        rows = connection.execute(sa.select(rollouts.path, rollouts.sha256))
        recorded = {work_name(path): sha256 for path, sha256 in rows}
    # One that was discarded since has no row, and is no part of the evidence.
    return sorted({rollout for rollout, sha256 in reviewed if recorded.get(rollout, sha256) != sha256})


def starts_of_tests(directory: Path) -> dict[tuple[str, int], tuple[float, ...]]:
    """Return the start of every test, by problem or closing check and number.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        rows = connection.execute(sa.text("SELECT problem, test, x FROM each_test")).all()
        return {(row.problem, row.test): tuple(json.loads(row.x)) for row in rows}


def observed(directory: Path) -> list[tuple[RolloutId, str, str]]:
    """Return (rollout, sha256, path) of every rollout behind an observation, by series, test and id.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    rollouts, seen = tables.rollouts.c, tables.observations.c
    # Joined with the observations: whether a rollout is recorded after its problem has stopped depends on the speed of
    # the workers, and the certificate must not.
    joined = tables.rollouts.join(
        tables.observations, (rollouts.problem == seen.problem) & (rollouts.block == seen.test)
    )
    rollout = (rollouts.problem, rollouts.test, rollouts.variant, rollouts.replicate)
    query = sa.select(*rollout, rollouts.sha256, rollouts.path, rollouts.places)
    with reading(directory) as connection:
        order = [problem.name for problem in read_header(connection, directory).config.problems]
        rows = list(connection.execute(query.select_from(joined)))
    rows.sort(key=lambda row: (*series_order(order, row.problem), *row[1:4], -row.places))
    return [(RolloutId(*row[:4]), str(row[4]), str(row[5])) for row in rows]
