"""A campaign database in the hands of someone with all rights."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from perfbound.orchestrator.store.rows import DATABASE


@contextmanager
def editing(directory: Path) -> Iterator[sqlite3.Connection]:
    """Edit a database without triggers and foreign keys."""
    database = sqlite3.connect(directory / DATABASE)
    for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        database.execute(f"DROP TRIGGER {name}")
    with database:
        yield database
    database.close()
