"""Read-only connections of the SQLite driver to a campaign database, whose file is untrusted."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from .damage import naming_cause
from .lock import is_held
from .rows import existing

LONGEST = 2**26
"""Bytes of one value."""


@contextmanager
def snapshot(directory: Path) -> Iterator[sqlite3.Connection]:
    """Open the database of a campaign at one moment in time, by the driver alone: SQLAlchemy takes long to load.

    Raises:
        JournalError: there is none, or it is damaged.
        OSError: the disk is full or fails.

    """
    path = existing(directory).resolve()
    with naming_cause(directory), closing(open_readonly(path, immutable=is_still(directory, path))) as connection:
        connection.execute("BEGIN")  # one snapshot for all queries, while the orchestrator commits
        yield connection


def open_readonly(path: Path, *, immutable: bool) -> sqlite3.Connection:
    """Open a database for reading; nothing in the file runs, and no value fills the memory."""
    query = "mode=ro&immutable=1" if immutable else "mode=ro"
    connection = sqlite3.connect(f"file:{quote(str(path))}?{query}", uri=True)
    try:
        connection.execute("PRAGMA trusted_schema=OFF")  # a view or a generated column of the file may call functions
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def is_still(directory: Path, path: Path) -> bool:
    """Whether a database has no writer and no log, so that a reader may take it as immutable."""
    # Without `immutable` every reader of a WAL database leaves -wal and -shm behind, beside a finished one too. With it
    # SQLite ignores a log: after kill -9 the last commits are there alone.
    return not is_held(directory) and not _size(path.with_name(f"{path.name}-wal"))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # also between two lines: the writer's last connection removes the log when it closes
        return 0
