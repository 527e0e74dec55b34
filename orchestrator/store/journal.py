"""The journal: the only writer of the campaign database."""

import os
import sqlite3
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from ...schemas.atomic import move, temporary
from ...schemas.errors import JournalError, one_line
from ...schemas.facts import RECORDED, Fact, Header, ProposalFact, RolloutFact
from ...schemas.failure import Failure
from ...schemas.ids import Attempt, RolloutId
from ...schemas.platforms import platform_class
from . import tables
from .read import read_facts, read_header, read_version
from .rows import (
    DATABASE,
    SCHEMA_VERSION,
    UNREADABLE,
    attempt_key,
    existing,
    fact_row,
    has_column,
    has_table,
    header_row,
    outcome_fields,
    proposal_fact,
    rollout_fact,
)

_INSERTS = (
    {table: table.insert() for table in tables.FACTS}
    | {table: table.insert().prefix_with("OR IGNORE") for table in (tables.attempts, tables.outcomes)}
    | {table: table.insert() for table in (tables.set_aside, tables.opinions)}
)
"""In the order of their foreign keys. An attempt may be written twice (OR IGNORE), a fact never."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the system of a session is that is not installed; outside the hash chain."""

    system: str | None = None
    """FILE.py:NAME, or the campaign file of a program."""
    revision: str | None = None
    """Of its folder: the commit, and whether files are changed; None where there is no repository."""


INSTALLED = Origin()


class Journal:
    """An open campaign database, used by one thread, under `campaign_lock`."""

    def __init__(self, directory: Path, engine: Engine, header: Header, origin: Origin) -> None:
        self.directory, self.header, self.origin = directory, header, origin
        self._engine = engine
        self._connection = engine.connect()
        self._place = os.stat(directory / DATABASE)
        self._version, self._seq = _position(self._connection, directory)
        self._pending: defaultdict[sa.Table, list[dict[str, Any]]] = defaultdict(list)
        self.session = _open_session(self._connection, self._version, origin)

    @classmethod
    def create(cls, directory: Path, header: Header, origin: Origin = INSTALLED) -> "Journal":
        """Make the database of a new campaign, whole or not at all."""
        # Under another name until it is whole: after kill -9 a database without its header would pass for a campaign.
        partial = temporary(directory / DATABASE)
        engine = open_engine(partial)
        with engine.begin() as connection:
            tables.metadata.create_all(connection)
            for trigger in tables.insert_only():
                connection.execute(sa.text(trigger))
            connection.execute(tables.schema.insert().values(version=SCHEMA_VERSION))
            connection.execute(tables.campaign.insert().values(seq=1, **header_row(header)))
        engine.dispose()
        move(partial, directory / DATABASE)
        return cls(directory, open_engine(directory / DATABASE), header, origin)

    @classmethod
    def open(cls, directory: Path, origin: Origin = INSTALLED) -> "Journal":
        """Open the database of an existing campaign.

        Raises:
            JournalError: there is none, or it is of another schema, or damaged.

        """
        engine = open_engine(_unlinked(existing(directory)))
        with ExitStack() as refused:
            refused.callback(engine.dispose)
            with _readable(directory):
                with engine.begin() as connection:
                    header = read_header(connection, directory)
                opened = cls(directory, engine, header, origin)
            refused.pop_all()
        return opened

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make all facts written inside durable together, or none of them."""
        before = self._seq
        try:
            yield
            self._flush()  # the first write begins the transaction: a turn of heartbeats touches no disk
            self._connection.commit()
        except BaseException:  # also a signal between two lines: numbers that are not in the database are given again
            self._seq = before
            self._pending.clear()
            self._connection.rollback()
            raise

    def add(self, fact: Fact) -> None:
        """Write one fact; inside `transaction` alone."""
        table, row = fact_row(fact)
        self._seq += 1
        self._pending[tables.metadata.tables[table]].append({"seq": self._seq, **row})

    def attempt_started(self, attempt: Attempt, worker: str, host: str, pid: int) -> None:
        """Write a new attempt, before it is assigned."""
        row = {"worker": worker, "host": host, "pid": pid, "session": self.session, "started": time.time()}
        self._pending[tables.attempts].append(attempt_key(attempt) | row)

    def attempt_ended(
        self, attempt: Attempt, worker: str, outcome: str | Failure, cpu: float = 0.0, wall: float = 0.0
    ) -> None:
        """Write the outcome of an attempt: RECORDED, RESTORED or a failure.

        A worker that was given up may still deliver its result, or report a failure. A result is written in any case,
        a failure of the infrastructure as the first outcome alone, a failure of the system as the first of its kind.
        """
        if isinstance(outcome, Failure) and self._read(_failures_of(attempt, outcome, self._version)):
            return
        row = {"worker": worker, "ended": time.time(), "cpu_seconds": cpu, "wall_seconds": wall}
        self._pending[tables.outcomes].append(attempt_key(attempt) | row | outcome_fields(outcome, self._version))

    def set_aside(self, kind: str, name: str, seconds: float, reason: str) -> None:
        """Write the pause of a worker or host, or 0 s for the end of one; databases before version 5 have no place."""
        if has_table("set_aside", self._version):
            row = {"kind": kind, "name": name, "seconds": seconds, "reason": reason}
            self._pending[tables.set_aside].append({"session": self.session, "at": time.time(), **row})

    def opinion(self, kind: str, attempt: Attempt, worker: str, sha256: str) -> None:
        """Write the digest of a result that is compared, outvoted or reviewed; not before version 5."""
        if has_table("opinions", self._version):
            row = {"kind": kind, "worker": worker, "sha256": sha256, "at": time.time()}
            self._pending[tables.opinions].append(attempt_key(attempt) | row)

    def suspects(self) -> list[RolloutId]:
        """Return the rollouts that an outvoted worker recorded and that no other one has simulated."""
        if not has_table("opinions", self._version):
            return []
        seen, ended = tables.opinions.c, tables.outcomes.c
        outvoted = sa.select(seen.worker).where(seen.kind == "outvoted")
        if not self._read(outvoted.limit(1)):
            return []
        others = sa.select(seen.rollout).where(seen.kind != "outvoted")
        query = sa.select(ended.rollout).where(ended.outcome == RECORDED, ended.worker.in_(outvoted))
        return [RolloutId.parse(row[0]) for row in self._read(query.where(ended.rollout.not_in(others)))]

    def _flush(self) -> None:
        """Write the pending rows, one statement a table: row by row, SQLAlchemy costs more than SQLite."""
        for table, insert in _INSERTS.items():
            if rows := self._pending.pop(table, None):
                self._connection.execute(insert, rows)

    def facts(self) -> Iterator[Fact]:
        """Yield all facts after the header in the order in which they were written."""
        with _readable(self.directory), self._connection.begin():
            yield from read_facts(self._connection)

    def recorded(self) -> list[RolloutFact]:
        """Return all recorded rollouts, the newest first."""
        newest = sa.select(tables.rollouts).order_by(tables.rollouts.c.seq.desc())
        with self._connection.begin():
            return [rollout_fact(row) for row in self._connection.execute(newest)]

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one; inside or outside a transaction."""
        columns = tables.tests.c
        (row,) = self._read(sa.select(tables.tests).where(columns.problem == problem, columns.test == test))
        return proposal_fact(row)

    def rollout(self, rollout: RolloutId) -> RolloutFact:
        """Return a recorded rollout; inside or outside a transaction."""
        columns = tables.rollouts.c
        this = [columns[name] == value for name, value in rollout._asdict().items()]
        (row,) = self._read(sa.select(tables.rollouts).where(*this))
        return rollout_fact(row)

    @property
    def platform(self) -> str:
        """The class of machines of the campaign: that of its file, else of the session that began it."""
        if self.header.config.platform is not None:
            return self.header.config.platform
        if not has_column("sessions", "platform", self._version):
            return platform_class()
        sessions = tables.sessions.c
        named = sa.select(sessions.platform).where(sessions.platform.is_not(None))  # the present session, at least
        ((found,),) = self._read(named.order_by(sessions.session).limit(1))
        return str(found)

    def worker_of(self, rollout: RolloutId, attempt: int | None = None) -> str | None:
        """Return the worker of an attempt, or the one whose result was recorded; inside or outside a transaction."""
        table = tables.outcomes if attempt is None else tables.attempts
        which = table.c.outcome == RECORDED if attempt is None else table.c.attempt == attempt
        rows = self._read(sa.select(table.c.worker).where(table.c.rollout == str(rollout), which))
        return str(rows[0][0]) if rows else None

    def _read(self, query: sa.Select[Any]) -> Sequence[sa.Row[Any]]:
        """Return the rows of a query; rows of the open transaction are among them."""
        if not self._connection.in_transaction() and not self._pending:
            with self._connection.begin():
                return self._connection.execute(query).all()
        self._flush()
        return self._connection.execute(query).all()

    def check_place(self) -> None:
        """Refuse to go on without the database: what is written now would be lost with the last open file.

        Raises:
            JournalError: another file is in its place, or none.

        """
        path = self.directory / DATABASE
        try:
            same = os.path.samestat(os.stat(path), self._place)
        except OSError:
            same = False
        if not same:
            raise JournalError(
                f"{path}: removed or replaced while the campaign was running; restore it from a copy, then resume"
            )

    def close(self) -> None:
        """Fold the write-ahead log into the database, and close it."""
        # SQLite folds the log when the last connection closes: with a reader at that moment, no connection would.
        if not self._connection.closed and not self._connection.in_transaction():
            driver = self._connection.connection.driver_connection
            assert driver is not None
            with suppress(sqlite3.Error):  # a full disk: the commits stay in the log
                driver.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._connection.close()
        self._engine.dispose()


@contextmanager
def _readable(directory: Path) -> Iterator[None]:
    """Turn an error of a damaged database into a `JournalError`; a full or failing disk is no fault of the file."""
    try:
        yield
    except sa.exc.DatabaseError as error:
        if _of_the_disk(error):
            raise
        raise JournalError(
            f"{directory / DATABASE}: not a campaign database ({error.orig}); restore it from a copy"
        ) from None
    except UNREADABLE as error:
        raise JournalError(
            f"{directory / DATABASE}: not a campaign database ({type(error).__name__}: {one_line(str(error))[:200]}); "
            "restore it from a copy"
        ) from None


def _unlinked(path: Path) -> Path:
    """Refuse a database, or a log beside it, that is a symbolic link: SQLite would write what it leads to."""
    for each in (path, *(path.with_name(f"{path.name}-{log}") for log in ("wal", "shm", "journal"))):
        if each.is_symlink():
            raise JournalError(f"{each}: a symbolic link; put the file itself there")
    return path


def _position(connection: Connection, directory: Path) -> tuple[int, int]:
    """Return the schema version of a database and its last sequence number."""
    with connection.begin():
        version = read_version(connection, directory)
        there = tables.facts_of_version(version)
        last = [connection.execute(sa.select(sa.func.max(table.c.seq))).scalar() for table in there]
        return version, max(seq or 0 for seq in last)


def _open_session(connection: Connection, version: int, origin: Origin) -> int:
    with connection.begin():
        row: dict[str, Any] = {"host": os.uname().nodename, "pid": os.getpid(), "started": time.time()}
        told = {"system": origin.system, "revision": origin.revision, "platform": platform_class()}
        row |= {name: value for name, value in told.items() if has_column("sessions", name, version)}
        key = connection.execute(tables.sessions.insert().values(**row)).inserted_primary_key
        assert key is not None
        return int(key[0])


def _failures_of(attempt: Attempt, failure: Failure, version: int) -> sa.Select[Any]:
    """Return the query of the outcomes of an attempt to which a failure adds nothing."""
    columns = tables.outcomes.c
    this = (columns.rollout == str(attempt.rollout)) & (columns.attempt == attempt.number)
    if failure.kind == "system" and has_column("outcomes", "kind", version):
        this &= columns.kind == "system"
    return sa.select(columns.attempt).where(this)


def _of_the_disk(error: sa.exc.DatabaseError) -> bool:
    """Whether the disk is full or failing, as opposed to the file being damaged."""
    code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF  # the primary code, without the detail
    return code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


def open_engine(path: Path) -> Engine:
    """Return the engine of a database that is written: a commit is on the disk when it returns."""
    engine = sa.create_engine(sa.URL.create("sqlite", database=str(path)))
    sa.event.listen(engine, "connect", _configure)
    sa.event.listen(engine, "begin", _begin_immediate)
    return engine


def _configure(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # SQLAlchemy begins and commits, not the driver
    # WAL: readers never block the writer. FULL: a commit is on the disk before a worker may drop its result.
    try:
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=10000"):
            connection.execute(f"PRAGMA {pragma}")
    except sqlite3.Error:  # SQLAlchemy closes no connection that it has not got yet
        connection.close()
        raise


def _begin_immediate(connection: Connection) -> None:
    # The write lock first: a transaction that reads and then writes fails without waiting if another one came between.
    connection.exec_driver_sql("BEGIN IMMEDIATE")
