"""The discard of a recorded rollout: its file is kept, and its row moves from `rollouts` to `discards`.

In one transaction: the database has either the rollout or its discard.
"""

from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection

from ...schemas import atomic
from ...schemas.result.facts import DiscardFact, RolloutFact
from . import tables
from .files import discarded_path, inside, read_evidence
from .journal import open_engine
from .rows import DATABASE


def write_discard(directory: Path, fact: RolloutFact, reason: str) -> DiscardFact:
    """Discard a recorded rollout of an open test; the run directory is locked, and the caller has found the reason.

    Raises:
        EvidenceError: its file is missing or damaged.
        OSError: the disk is full.

    """
    kept = discarded_path(fact.rollout, fact.sha256)
    # First the copy, then the row: what a crash leaves between them is overwritten by the next call. The file itself
    # has no row from then on, so that a resume sweeps it.
    atomic.write_whole(inside(directory, kept), read_evidence(directory, fact.path, fact.sha256))
    engine = open_engine(directory / DATABASE)
    try:
        with engine.begin() as connection:
            _move(connection, fact, kept, reason)
    finally:
        engine.dispose()
    return DiscardFact(fact.rollout, fact.seed, fact.sha256, fact.size, kept, reason)


def _move(connection: Connection, fact: RolloutFact, kept: str, reason: str) -> None:
    columns = tables.rollouts.c
    this = sa.and_(*(columns[name] == value for name, value in fact.rollout._asdict().items()))
    row: dict[str, Any] = dict(connection.execute(sa.select(tables.rollouts).where(this)).one()._mapping)
    newest = [connection.execute(sa.select(sa.func.max(table.c.seq))).scalar() or 0 for table in tables.FACTS]
    row = {name: value for name, value in row.items() if name in tables.discards.c}
    row |= {"recorded": row["seq"], "seq": max(newest) + 1, "path": kept, "reason": reason}
    # Moved, not marked: a second row for one rollout would have to be left out of every query.
    connection.execute(tables.discards.insert().values(**row))
    unguarded(connection, tables.rollouts, tables.rollouts.delete().where(this))


def unguarded(connection: Connection, table: sa.Table, change: sa.Update | sa.Delete) -> None:
    """Change an insert-only table without its triggers."""
    mine = [trigger for trigger in tables.insert_only() if f" ON {table.name} " in trigger]
    for trigger in mine:
        connection.exec_driver_sql(f"DROP TRIGGER {trigger.split()[2]}")
    connection.execute(change)
    for trigger in mine:
        connection.exec_driver_sql(trigger)
