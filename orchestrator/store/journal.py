"""The journal: the only writer of the campaign database."""

import hashlib
import json
import os
import sqlite3
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Engine

from ...schemas.atomic import move, temporary
from ...schemas.base import canonical_json
from ...schemas.campaign import CampaignConfig
from ...schemas.errors import JournalError
from ...schemas.facts import (
    RECORDED,
    RESTORED,
    BoundFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from ...schemas.ids import Attempt, RolloutId
from ...schemas.rules import check_rules
from ...schemas.system import SystemSpec
from ...schemas.values import Bound, Observation, Proposal
from . import tables

DATABASE = "campaign.db"
_INSERTS = {table: table.insert() for table in tables.FACTS} | {
    table: table.insert().prefix_with("OR IGNORE") for table in (tables.attempts, tables.outcomes)
}
"""In this order: what a foreign key names is written before."""


class Journal:
    """An open campaign database; one orchestrator has it, under `campaign_lock`."""

    def __init__(self, engine: Engine, header: Header) -> None:
        self.header = header
        self._engine = engine
        self._connection = engine.connect()
        self._seq = self._last_seq()
        self._pending: defaultdict[sa.Table, list[dict[str, Any]]] = defaultdict(list)
        self.session = self._open_session()

    @classmethod
    def create(cls, directory: Path, header: Header) -> "Journal":
        """Make the database of a new campaign, whole or not at all."""
        partial = temporary(directory / DATABASE)
        engine = _engine(partial)
        with engine.begin() as connection:
            tables.metadata.create_all(connection)
            for trigger in tables.insert_only():
                connection.execute(sa.text(trigger))
            connection.execute(tables.schema.insert().values(version=tables.SCHEMA_VERSION))
            connection.execute(tables.campaign.insert().values(seq=1, **_header_row(header)))
        engine.dispose()
        move(partial, directory / DATABASE)
        return cls(_engine(directory / DATABASE), header)

    @classmethod
    def open(cls, directory: Path) -> "Journal":
        """Open the database of an existing campaign.

        Raises:
            JournalError: there is none, or it is of another schema, or damaged.

        """
        engine = _engine(existing(directory))
        try:
            with engine.begin() as connection:
                header = read_header(connection, directory)
        except sa.exc.DatabaseError as error:
            if _of_the_disk(error):
                raise
            raise JournalError(f"{directory / DATABASE}: not a campaign database ({error.orig})") from None
        return cls(engine, header)

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make all facts written inside durable together, or none of them."""
        before = self._seq
        try:
            yield
            self._flush()  # the first write begins the transaction: a turn of heartbeats touches no disk
            self._connection.commit()
        except BaseException:
            self._seq = before
            self._pending.clear()
            self._connection.rollback()
            raise

    def add(self, fact: Fact) -> None:
        """Write one fact; inside `transaction` only."""
        table, row = _row(fact)
        self._seq += 1
        self._pending[table].append({"seq": self._seq, **row})

    def attempt_started(self, attempt: Attempt, worker: str, host: str, pid: int) -> None:
        """Write down a new attempt before it is assigned."""
        row = {"worker": worker, "host": host, "pid": pid, "session": self.session, "started": time.time()}
        self._pending[tables.attempts].append(_attempt(attempt) | row)

    def attempt_ended(self, attempt: Attempt, worker: str, outcome: str, cpu: float = 0.0, wall: float = 0.0) -> None:
        """Write down how an attempt ended: the first account of a failure, and a result even after that."""
        if outcome not in (RECORDED, RESTORED) and self._has_ended(attempt):
            return
        row = {"worker": worker, "ended": time.time(), "outcome": outcome, "cpu_seconds": cpu, "wall_seconds": wall}
        self._pending[tables.outcomes].append(_attempt(attempt) | row)

    def _flush(self) -> None:
        """Write what waits, one statement a table: row by row, SQLAlchemy costs more than SQLite."""
        for table, insert in _INSERTS.items():
            if rows := self._pending.pop(table, None):
                self._connection.execute(insert, rows)

    def _has_ended(self, attempt: Attempt) -> bool:
        self._flush()
        columns = tables.outcomes.c
        this = (columns.rollout == str(attempt.rollout)) & (columns.attempt == attempt.number)
        return self._connection.execute(sa.select(columns.attempt).where(this)).first() is not None

    def facts(self) -> Iterator[Fact]:
        """Yield all facts after the header in the order in which they were written."""
        with self._connection.begin():
            yield from read_facts(self._connection)

    def attempts(self) -> dict[RolloutId, int]:
        """Return the highest attempt number of every rollout."""
        columns = tables.attempts.c
        query = sa.select(columns.rollout, sa.func.max(columns.attempt)).group_by(columns.rollout)
        with self._connection.begin():
            return {RolloutId.parse(rollout): number for rollout, number in self._connection.execute(query)}

    def observed(self) -> list[tuple[RolloutId, str, str]]:
        """Return (rollout, sha256, path) of every rollout behind an observation, by problem, test and id.

        A rollout that was recorded after its problem had stopped depends on luck and is not evidence of anything.
        """
        rollouts, seen = tables.rollouts.c, tables.observations.c
        joined = tables.rollouts.join(
            tables.observations, (rollouts.problem == seen.problem) & (rollouts.test == seen.test)
        )
        rollout = (rollouts.problem, rollouts.test, rollouts.variant, rollouts.replicate)
        columns = (*rollout, rollouts.sha256, rollouts.path)
        order: list[str] = [problem.name for problem in self.header.config.problems]
        with self._connection.begin():
            rows = self._connection.execute(sa.select(*columns).select_from(joined)).all()
        found = [(RolloutId(*row[:4]), str(row[4]), str(row[5])) for row in rows]
        return sorted(found, key=lambda entry: (order.index(entry[0].problem), *entry[0][1:]))

    def recorded(self) -> list[RolloutFact]:
        """Return all recorded rollouts, the newest first."""
        newest = sa.select(tables.rollouts).order_by(tables.rollouts.c.seq.desc())
        with self._connection.begin():
            return [_rollout(row) for row in self._connection.execute(newest)]

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one."""
        columns = tables.tests.c
        query = sa.select(tables.tests).where(columns.problem == problem, columns.test == test)
        with self._connection.begin():
            return _proposal(self._connection.execute(query).one())

    def close(self) -> None:
        """Fold the write-ahead log into the database, and close it.

        SQLite folds it when the last connection closes; where somebody reads at that moment, it would stay for ever.
        """
        if not self._connection.closed and not self._connection.in_transaction():
            driver = self._connection.connection.driver_connection
            assert driver is not None
            with suppress(sqlite3.Error):  # a full disk: what is committed stays in the log
                driver.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._connection.close()
        self._engine.dispose()

    def _last_seq(self) -> int:
        with self._connection.begin():
            return max(
                self._connection.execute(sa.select(sa.func.max(table.c.seq))).scalar() or 0 for table in tables.FACTS
            )

    def _open_session(self) -> int:
        with self._connection.begin():
            row = {"host": os.uname().nodename, "pid": os.getpid(), "started": time.time()}
            result = self._connection.execute(tables.sessions.insert().values(**row))
            key = result.inserted_primary_key
            assert key is not None
            return int(key[0])


def existing(directory: Path) -> Path:
    """Return the database of a campaign.

    Raises:
        JournalError: there is none in `directory`.

    """
    path = directory / DATABASE
    if not path.is_file():
        raise JournalError(
            f"{directory}: no campaign here (no {DATABASE}); start one with `perfbound run CAMPAIGN.toml`"
        )
    return path


def read_header(connection: Connection, directory: Path) -> Header:
    """Read the first fact.

    Raises:
        JournalError: the database is of another schema version, or its header is missing or was changed.

    """
    version = connection.execute(sa.select(tables.schema.c.version)).scalar()
    if version not in tables.READ_VERSIONS:
        raise JournalError(
            f"{directory / DATABASE}: schema version {version}, this perfbound reads {tables.SCHEMA_VERSION}; "
            "use the perfbound that wrote it, or a newer one"
        )
    columns = [tables.campaign.c[name] for name in tables.columns(tables.campaign, version)]
    rows = connection.execute(sa.select(*columns).limit(2)).all()
    row = rows[0] if rows else None
    try:
        if row is None:
            raise ValueError("it is missing")
        if len(rows) != 1:
            raise ValueError("there are several")
        found, system = (hashlib.sha256(text.encode()).hexdigest() for text in (row.config, row.system))
        if found != row.config_sha256:
            raise ValueError("the campaign file is another one")
        config, spec = CampaignConfig.model_validate_json(row.config), SystemSpec.model_validate_json(row.system)
        if (row.name, row.seed) != (config.name, config.seed):
            raise ValueError("name or seed are not the file's")
        rules = check_rules(getattr(row, "rules", 1), str(directory / DATABASE))
        return Header(row.run, config, spec, json.loads(row.software), found, system, rules)
    except (ValueError, AttributeError, TypeError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise JournalError(
            f"{directory / DATABASE}: the header was changed after the start ({reason}); restore it from a copy"
        ) from None


def read_facts(connection: Connection) -> Iterator[Fact]:
    """Yield all facts after the header in the order in which they were written."""
    rows = [(row.seq, make(row)) for table, make in READERS.items() for row in connection.execute(sa.select(table))]
    rows.sort(key=lambda pair: pair[0])
    for _, fact in rows:
        yield fact


def _proposal(row: Any) -> ProposalFact:
    x = tuple(json.loads(row.x))
    return ProposalFact(row.problem, row.test, Proposal(row.node, x, row.mu, row.sigma, row.beta, row.F))


def _rollout(row: Any) -> RolloutFact:
    rollout = RolloutId(row.problem, row.test, row.variant, row.replicate)
    return RolloutFact(rollout, row.seed, row.sha256, row.size, row.path, row.robustness)


def _observation(row: Any) -> ObservationFact:
    found = Observation(row.y, tuple(json.loads(row.each)))
    return ObservationFact(row.problem, row.test, found, row.chain)


def _bound(row: Any) -> BoundFact:
    budget = row.stopped_by == "budget"
    bound = Bound(row.upper, row.lower, None if budget else row.stopped_by)
    return BoundFact(row.problem, row.test, bound, budget)


READERS: dict[sa.Table, Callable[[Any], Fact]] = {
    tables.tests: _proposal,
    tables.rollouts: _rollout,
    tables.observations: _observation,
    tables.bounds: _bound,
}
"""How a row of each table becomes a fact."""


def _header_row(header: Header) -> dict[str, Any]:
    return {
        "run": header.run,
        "name": header.config.name,
        "seed": header.config.seed,
        "config": canonical_json(header.config.model_dump(mode="json")),
        "config_sha256": header.config_sha256,
        "system": canonical_json(header.spec.model_dump(mode="json")),
        "software": canonical_json(header.software),
        "rules": header.rules,
    }


def _row(fact: Fact) -> tuple[sa.Table, dict[str, Any]]:
    # SQLite turns NaN into NULL without a word; canonical_json refuses it here, for every kind of fact.
    match fact:
        case ProposalFact(problem, test, chosen):
            row = {"problem": problem, "test": test, **_fields(chosen), "x": canonical_json(list(chosen.x))}
            table = tables.tests
        case RolloutFact():
            row = _fields(fact)
            row |= row.pop("rollout")._asdict()
            table = tables.rollouts
        case ObservationFact(problem, test, found, chain):
            row = {"problem": problem, "test": test, "y": found.y, "each": canonical_json(list(found.each))}
            row["chain"] = chain
            table = tables.observations
        case BoundFact(problem, test, bound):
            row = {"problem": problem, "test": test, "upper": bound.upper, "lower": bound.lower}
            row["stopped_by"] = fact.stopped_by
            table = tables.bounds
    canonical_json(row)
    return table, row


def _attempt(attempt: Attempt) -> dict[str, Any]:
    return {"rollout": str(attempt.rollout), "attempt": attempt.number}


def _fields(value: RolloutFact | Proposal) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__slots__}


def _of_the_disk(error: sa.exc.DatabaseError) -> bool:
    """Whether the disk is at fault (full, failing), and not the file."""
    code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF  # the primary code, without the detail
    return code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


def _engine(path: Path) -> Engine:
    engine = sa.create_engine(sa.URL.create("sqlite", database=str(path)))
    sa.event.listen(engine, "connect", _configure)
    sa.event.listen(engine, "begin", _begin_immediate)
    return engine


def _configure(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # SQLAlchemy begins and commits, not the driver
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=10000"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_immediate(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")
