"""The facts of an untrusted campaign database, table by table."""

from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from ...schemas.errors import JournalError
from ...schemas.facts import (
    BoundFact,
    DiscardFact,
    ExtensionFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from . import tables
from .read import read_header, read_version, reading
from .rows import DATABASE, READ_VERSIONS, READERS


@dataclass(frozen=True, slots=True)
class UntrustedFacts:
    """The facts of a database; a table that is gone or empty is an empty tuple."""

    header: Header
    proposals: tuple[ProposalFact, ...]
    rollouts: tuple[RolloutFact, ...]
    discards: tuple[DiscardFact, ...]
    observations: tuple[ObservationFact, ...]
    bounds: tuple[BoundFact, ...]
    extensions: tuple[ExtensionFact, ...]


def read_untrusted(directory: Path) -> UntrustedFacts:
    """Read the facts as they are stored, without any conclusion from them.

    Raises:
        JournalError: there is no database, or its header or a row cannot be read.

    """
    with reading(directory) as connection:
        there = _shape(connection, directory)
        header = read_header(connection, directory)
        return UntrustedFacts(header, *(_rows(connection, directory, name, there) for name in READERS))  # type: ignore[arg-type]


def read_untrusted_header(directory: Path) -> Header:
    """Return the first fact.

    Raises:
        JournalError: there is no database, or its header cannot be read.

    """
    with reading(directory) as connection:
        _shape(connection, directory)
        return read_header(connection, directory)


def _shape(connection: sa.Connection, directory: Path) -> set[str]:
    """Return the names of the tables, if all of them are perfbound's."""
    # A view or a generated column computes while it is read, perhaps without end.
    master = connection.exec_driver_sql("SELECT name, type FROM sqlite_master WHERE type IN ('table', 'view')").all()
    for name, kind in master:
        table = tables.metadata.tables.get(name)
        if kind != "table" or (table is None and not name.startswith("sqlite_")):
            raise JournalError(f"{directory / DATABASE}: the {kind} {str(name)[:80]} is not perfbound's")
        if table is not None:
            quoted = name.replace('"', '""')
            columns = connection.exec_driver_sql(f'PRAGMA table_xinfo("{quoted}")').all()
            expected = [tables.columns_of_version(table, version) for version in READ_VERSIONS]
            if [row.name for row in columns] not in expected or any(row.hidden for row in columns):
                raise JournalError(f"{directory / DATABASE}: the table {name} has other columns than perfbound's")
    return {name for name, _ in master}


def _rows(connection: sa.Connection, directory: Path, name: str, there: set[str]) -> tuple[Fact, ...]:
    if name not in there:
        return ()  # a header alone is enough to decide the campaign again from its files
    table, version = tables.metadata.tables[name], read_version(connection, directory)
    query = tables.rows_of(table, version).order_by(table.c.seq)
    try:
        return tuple(READERS[name](row) for row in connection.execute(query))
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        raise JournalError(f"{directory / DATABASE}: table {name}: a row cannot be read ({error})") from None
