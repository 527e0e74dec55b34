"""Rows that wait for the end of a transaction, and queries that see them."""

from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection
from sqlalchemy.dialects import sqlite

from . import tables

_INSERTS = (
    {table: table.insert() for table in tables.FACTS}
    | {table: table.insert().prefix_with("OR IGNORE") for table in (tables.attempts, tables.outcomes)}
    | {table: table.insert() for table in (tables.set_aside, tables.opinions)}
)
"""In the order of their foreign keys. An attempt may be written twice (OR IGNORE), a fact never."""


@lru_cache
def _insert(table: sa.Table, columns: tuple[str, ...]) -> str:
    """Return the statement for rows with these columns.

    To look it up in SQLAlchemy takes as long as SQLite takes to carry it out.
    """
    return str(_INSERTS[table].compile(dialect=sqlite.dialect(paramstyle="named"), column_keys=columns))


class PendingRows:
    """The rows of the open transaction of a connection."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._rows: defaultdict[sa.Table, list[dict[str, Any]]] = defaultdict(list)

    def add(self, table: sa.Table, row: dict[str, Any]) -> None:
        """Add one row; nothing touches the disk yet."""
        self._rows[table].append(row)

    @property
    def waiting(self) -> bool:
        """Whether there are rows that have not been written."""
        return bool(self._rows)

    def clear(self) -> None:
        """Drop what has not been written."""
        self._rows.clear()

    def flush(self) -> None:
        """Write the rows, one statement a table, and past SQLAlchemy, which costs more than SQLite."""
        if not self._rows:
            return
        if not self._connection.in_transaction():
            self._connection.begin()
        driver = self._connection.connection.driver_connection
        assert driver is not None
        for table in _INSERTS:
            if rows := self._rows.pop(table, None):
                driver.executemany(_insert(table, tuple(rows[0])), rows)

    def read(self, query: sa.Select[Any]) -> Sequence[sa.Row[Any]]:
        """Return the rows of a query; rows of the open transaction are among them."""
        if not self._connection.in_transaction() and not self._rows:
            with self._connection.begin():
                return self._connection.execute(query).all()
        self.flush()
        return self._connection.execute(query).all()
