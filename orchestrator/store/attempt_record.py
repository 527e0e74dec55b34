"""The digests of the tables that say who simulated what, and how it ended."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from ...schemas.attempt_record import TABLES, TableDigest
from .read import reading


def table_digests(directory: Path, rows: Mapping[str, int] | None = None) -> dict[str, TableDigest]:
    """Return the number of rows of each table of attempts, and the digest of their values.

    With `rows` of their first rows alone, as many as it says: later ones belong to a later session. A table that a
    database of an earlier schema version lacks has none.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    found = {}
    with reading(directory) as connection:
        there = {name for (name,) in connection.exec_driver_sql("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in TABLES:
            made, number = hashlib.sha256(), 0
            if table in there:
                # No row is ever removed: the row number is the order in which they were written.
                every: sa.Select[Any] = sa.select(sa.literal_column("*")).select_from(sa.table(table))
                first = every.order_by(sa.literal_column("rowid")).limit(None if rows is None else rows.get(table, 0))
                for row in connection.execute(first):
                    made.update(json.dumps(list(row), default=repr).encode() + b"\n")
                    number += 1
            found[table] = TableDigest(rows=number, sha256=made.hexdigest())
    return found
