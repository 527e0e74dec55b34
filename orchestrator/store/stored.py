"""What a campaign database holds, table by table, for somebody who does not trust it."""

import json
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from orchestrator.errors import JournalError
from orchestrator.store.journal import (
    DATABASE,
    READERS,
    BoundFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
    read_header,
)
from orchestrator.store.queries import reading


@dataclass(frozen=True, slots=True)
class Stored:
    """The facts of a database; a table that is gone or empty is an empty tuple."""

    header: Header
    proposals: tuple[ProposalFact, ...]
    rollouts: tuple[RolloutFact, ...]
    observations: tuple[ObservationFact, ...]
    bounds: tuple[BoundFact, ...]


def stored(directory: Path) -> Stored:
    """Read what is there, and nothing into it.

    Raises:
        JournalError: there is no database, or its header or a row cannot be read.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        there = set(sa.inspect(connection).get_table_names())
        return Stored(header, *(_rows(connection, directory, table, there) for table in READERS))  # type: ignore[arg-type]


def _rows(connection: sa.Connection, directory: Path, table: sa.Table, there: set[str]) -> tuple[Fact, ...]:
    if table.name not in there:
        return ()
    try:
        return tuple(READERS[table](row) for row in connection.execute(sa.select(table).order_by(table.c.seq)))
    except (ValueError, TypeError, json.JSONDecodeError) as error:
        raise JournalError(f"{directory / DATABASE}: table {table.name}: a row cannot be read ({error})") from None
