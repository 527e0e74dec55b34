"""The journal: the only writer of the campaign database."""

import getpass
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from ...schemas.atomic import move, temporary
from ...schemas.base import canonical_json
from ...schemas.errors import JournalError
from ...schemas.host import host_name
from ...schemas.ids import RolloutId
from ...schemas.platforms import platform_class
from ...schemas.ranges import LARGEST_BATCH
from ...schemas.result.block_facts import BatchFact, StoredFact
from ...schemas.result.facts import Header, ProposalFact, RolloutFact
from . import tables
from .attempts import AttemptLog
from .commit_times import CommitTimes
from .damage import naming_cause
from .facts import fact_row, proposal_fact, rollout_fact, stored_facts
from .lock import RunLock
from .pending import PendingRows
from .read import check_schema, read_header
from .rows import (
    DATABASE,
    SCHEMA_VERSION,
    existing,
    header_row,
)


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a session has its system, if that is not installed, and its workers; outside the hash chain."""

    system: str | None = None
    """FILE.py:NAME, or the campaign file of a program."""
    revision: str | None = None
    """Of its folder: the commit, and whether files are changed; None where there is no repository."""
    options: tuple[str, ...] | None = None
    """Those of `perfbound resume` for the same workers, none for local ones; None if the session has no workers."""


INSTALLED = Origin()


class Journal:
    """An open campaign database, used by one thread, under `campaign_lock`."""

    def __init__(
        self, directory: Path, engine: Engine, header: Header, origin: Origin, held: RunLock | None = None
    ) -> None:
        self.directory, self.header, self.origin, self._held = directory, header, origin, held
        self._process = os.getpid()
        self._engine = engine
        self._connection = engine.connect()
        self._seq = _last_fact(self._connection)
        self._rows = PendingRows(self._connection)
        self.session = _open_session(self._connection, origin)
        self.attempts = AttemptLog(self._rows, self.session)
        self.commits = CommitTimes()
        """Of the transactions that wrote."""
        # Text, since a Path takes longer than the question, and every transaction asks twice.
        self._places = str(directory / DATABASE), str(directory / f"{DATABASE}-wal")
        self._seen = _states(self._places)

    @classmethod
    def create(
        cls, directory: Path, header: Header, origin: Origin = INSTALLED, held: RunLock | None = None
    ) -> "Journal":
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
        return cls(directory, open_engine(directory / DATABASE), header, origin, held)

    @classmethod
    def open(cls, directory: Path, origin: Origin = INSTALLED, held: RunLock | None = None) -> "Journal":
        """Open the database of an existing campaign.

        Raises:
            JournalError: there is none, or it is of another schema version, or damaged.

        """
        engine = open_engine(_unlinked(existing(directory)))
        with ExitStack() as refused:
            refused.callback(engine.dispose)
            with naming_cause(directory):
                with engine.begin() as connection:
                    check_schema(connection, directory)
                    header = read_header(connection, directory)
                opened = cls(directory, engine, header, origin, held)
            refused.pop_all()
        return opened

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make all facts written inside durable together, or none of them."""
        before = self._seq
        try:
            yield
            writes, began = self._rows.waiting or self._connection.in_transaction(), time.perf_counter()
            if writes and self._held is not None:
                self._held.check()  # a node that was cut off from its files for minutes may have lost the lock
            self._rows.flush()  # the first write begins the transaction: a turn of heartbeats touches no disk
            if writes:
                self._check_files()
            self._connection.commit()
            if writes:
                self._check_files()  # again: a commit waits for the disk, and most cuts come in that time
                self.commits = self.commits.with_one(time.perf_counter() - began)
        except BaseException:  # also a signal between two lines: numbers that are not in the database are given again
            self._seq = before
            self._rows.clear()
            self._connection.rollback()
            raise

    def add(self, fact: StoredFact) -> None:
        """Write one fact; inside `transaction` alone."""
        table, row = fact_row(fact)
        self._seq += 1
        self._rows.add(tables.metadata.tables[table], {"seq": self._seq, **row})

    def facts(self) -> Iterator[StoredFact]:
        """Yield all facts after the header in the order in which they were written."""
        with naming_cause(self.directory), self._connection.begin():
            yield from stored_facts(self._connection)

    def recorded(self) -> list[RolloutFact | BatchFact]:
        """Return all recorded rollouts and batches, the newest first."""
        newest = sa.select(tables.rollouts).order_by(tables.rollouts.c.seq.desc())
        with self._connection.begin():
            return [rollout_fact(row) for row in self._connection.execute(newest)]

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one; inside or outside a transaction."""
        columns = tables.tests.c
        # The newest one up to there is its own, or that of its block.
        query = sa.select(tables.tests).where(columns.problem == problem, columns.test <= test)
        (row,) = self._rows.read(query.order_by(columns.test.desc()).limit(1))
        found = proposal_fact(row)
        return found if isinstance(found, ProposalFact) else found.of_test(test)

    def rollout(self, rollout: RolloutId) -> RolloutFact:
        """Return a recorded rollout; inside or outside a transaction."""
        return self._stored(rollout)[1]

    def batch_of(self, rollout: RolloutId) -> BatchFact | None:
        """Return the batch of a recorded rollout; None for one without; inside or outside a transaction."""
        found, _ = self._stored(rollout)
        return found if isinstance(found, BatchFact) else None

    def _stored(self, rollout: RolloutId) -> tuple[RolloutFact | BatchFact, RolloutFact]:
        """Return the fact that has a recorded rollout, and that of the rollout alone."""
        columns, (problem, test, variant, replicate) = tables.rollouts.c, rollout
        first, places = columns.test, columns.places
        tests = (first <= test, first + places / columns.replicates > test, first > test - LARGEST_BATCH)
        numbers = (columns.replicate <= replicate, columns.replicate > replicate - columns.replicates)
        same = (columns.problem == problem, columns.variant == variant)
        query = sa.select(tables.rollouts).where(*same, *tests, *numbers)
        found = (rollout_fact(row) for row in self._rows.read(query.order_by(places)))
        pairs = ((each, each if isinstance(each, RolloutFact) else each.alone(rollout)) for each in found)
        # The batch in which it failed may have it as well.
        return next((each, alone) for each, alone in pairs if alone is not None)

    def file(self, path: str) -> RolloutFact | BatchFact | None:
        """Return what is recorded in a file; None for nothing; inside or outside a transaction."""
        rows = self._rows.read(sa.select(tables.rollouts).where(tables.rollouts.c.path == path))
        return rollout_fact(rows[0]) if rows else None

    @property
    def platform(self) -> str:
        """The class of machines of the campaign: that of its file, else of the session that began it."""
        if self.header.config.platform is not None:
            return self.header.config.platform
        sessions = tables.sessions.c
        ((found,),) = self._rows.read(sa.select(sessions.platform).order_by(sessions.session).limit(1))
        return str(found)

    def check_place(self) -> None:
        """Refuse to continue without the database or the lock: what is written now would be lost, or another's too.

        Raises:
            JournalError: another file is in its place, or none.
            PerfboundError: the lock is lost.

        """
        if self._held is not None:
            self._held.check()
        self._check_files()

    def _check_files(self) -> None:
        """Refuse a database or a log that another hand has replaced or cut.

        SQLite continues from its memory: it would write over the gap, and find it, if at all, after the certificate.
        """
        now = _states(self._places)
        for path, (device, inode, size) in self._seen.items():
            if now.get(path, (0, 0, 0))[:2] != (device, inode):
                raise JournalError(
                    f"{path}: removed or replaced while the campaign was running; restore it from a copy, then resume"
                )
            if now[path][2] < size:
                raise JournalError(
                    f"{path}: cut from {size} to {now[path][2]} bytes while the campaign was running; restore the run "
                    "directory from a copy, then resume"
                )
        self._seen = now

    def close(self) -> None:
        """Fold the write-ahead log into the database, and close it; a fork of this process leaves both alone."""
        if os.getpid() != self._process:  # SQLite allows no use of a connection across a fork, not even its close
            return
        # SQLite folds the log when the last connection closes: with a reader at that moment, no connection would.
        # Without the lock the database may be another orchestrator's.
        kept = self._held is None or self._held.is_kept()
        if kept and not self._connection.closed and not self._connection.in_transaction():
            driver = self._connection.connection.driver_connection
            assert driver is not None
            with suppress(sqlite3.Error):  # a full disk: the commits stay in the log
                driver.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._connection.close()
        self._engine.dispose()


def _unlinked(path: Path) -> Path:
    """Refuse a database, or a log beside it, that is a symbolic link: SQLite would write what it leads to."""
    for each in (path, *(path.with_name(f"{path.name}-{log}") for log in ("wal", "shm", "journal"))):
        if each.is_symlink():
            raise JournalError(f"{each}: a symbolic link; put the file itself there")
    return path


def _states(paths: Iterable[str]) -> dict[str, tuple[int, int, int]]:
    """Return device, inode and size of the database and its log; while it is open neither gets smaller."""
    # Never by opening them: the close of any descriptor of a file takes the locks of SQLite from this process.
    found = {}
    for path in paths:
        with suppress(OSError):  # missing
            state = os.stat(path)
            found[path] = (state.st_dev, state.st_ino, state.st_size)
    return found


def _last_fact(connection: Connection) -> int:
    """Return the last sequence number of a database."""
    with connection.begin():
        last = [connection.execute(sa.select(sa.func.max(table.c.seq))).scalar() for table in tables.FACTS]
        return max(seq or 0 for seq in last)


def _open_session(connection: Connection, origin: Origin) -> int:
    with connection.begin():
        row = {
            "host": host_name(),
            "pid": os.getpid(),
            "started": time.time(),
            "system": origin.system,
            "revision": origin.revision,
            "platform": platform_class(),
            # Outside of chain and certificate: who ran a campaign proves nothing, and names are not for everybody.
            "account": _account(),
            "options": None if origin.options is None else canonical_json(list(origin.options)),
        }
        key = connection.execute(tables.sessions.insert().values(**row)).inserted_primary_key
        assert key is not None
        return int(key[0])


def _account() -> str | None:
    """Return the name of the user; None where the system knows none, as in some containers."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return None


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
