"""The digests of the tables that say who simulated what, and how it ended."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import sqlalchemy as sa

from ...schemas.result.attempt_record import TABLES, TableDigest
from . import tables
from .read import reading


def table_digests(directory: Path, rows: Mapping[str, int] | None = None) -> dict[str, TableDigest]:
    """Return the number of rows of each table of attempts, and the digest of their values.

    With `rows` of their first rows alone, as many as it says: later ones belong to a later session.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    found = {}
    with reading(directory) as connection:
        for name in TABLES:
            made, number = hashlib.sha256(), 0
            # No row is ever removed: the row number is the order in which they were written.
            every = sa.select(tables.metadata.tables[name]).order_by(sa.literal_column("rowid"))
            for row in connection.execute(every.limit(None if rows is None else rows.get(name, 0))):
                # `repr`, for an edited table may contain any type, and must differ and not raise.
                made.update(json.dumps(list(row), default=repr).encode() + b"\n")
                number += 1
            found[name] = TableDigest(rows=number, sha256=made.hexdigest())
    return found
