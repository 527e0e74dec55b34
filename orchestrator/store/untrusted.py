"""The facts of an untrusted campaign database, table by table."""

from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from ...schemas.errors import JournalError
from ...schemas.result.block_facts import BatchFact, BlockObservationFact, BlockProposalFact, StoredFact
from ...schemas.result.facts import (
    BoundFact,
    DiscardFact,
    ExtensionFact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from . import tables
from .facts import READERS
from .read import check_schema, read_header, reading_untrusted
from .rows import DATABASE


@dataclass(frozen=True, slots=True)
class UntrustedFacts:
    """The facts of a database; a table that is gone or empty is an empty tuple."""

    header: Header
    proposals: tuple[ProposalFact | BlockProposalFact, ...]
    rollouts: tuple[RolloutFact | BatchFact, ...]
    discards: tuple[DiscardFact, ...]
    observations: tuple[ObservationFact | BlockObservationFact, ...]
    bounds: tuple[BoundFact, ...]
    extensions: tuple[ExtensionFact, ...]


def read_untrusted(directory: Path) -> UntrustedFacts:
    """Read the facts as they are stored, without any conclusion from them.

    Raises:
        JournalError: there is no database, or its header or a row cannot be read.

    """
    with reading_untrusted(directory) as connection:
        there = _shape(connection, directory)
        header = read_header(connection, directory)
        return UntrustedFacts(header, *(_rows(connection, directory, name, there) for name in READERS))  # type: ignore[arg-type]


def read_untrusted_header(directory: Path) -> Header:
    """Return the first fact.

    Raises:
        JournalError: there is no database, or its header cannot be read.

    """
    with reading_untrusted(directory) as connection:
        _shape(connection, directory)
        return read_header(connection, directory)


def _shape(connection: sa.Connection, directory: Path) -> set[str]:
    """Return the names of the tables, if all of them are perfbound's and of its schema version."""
    # A view or a generated column computes while it is read, perhaps without end.
    master = connection.exec_driver_sql("SELECT name, type FROM sqlite_master WHERE type IN ('table', 'view')").all()
    for name, kind in master:
        if kind != "table" or (name not in tables.metadata.tables and not name.startswith("sqlite_")):
            raise JournalError(f"{directory / DATABASE}: the {kind} {str(name)[:80]} is not perfbound's")
    there = {name for name, _ in master}
    # The version comes before the other tables, which in another version have other columns.
    if tables.schema.name in there:
        _check_columns(connection, directory, tables.schema)
    check_schema(connection, directory)
    for name in sorted(there & tables.metadata.tables.keys()):
        _check_columns(connection, directory, tables.metadata.tables[name])
    return there


def _check_columns(connection: sa.Connection, directory: Path, table: sa.Table) -> None:
    columns = connection.exec_driver_sql(f'PRAGMA table_xinfo("{table.name}")').all()
    if [row.name for row in columns] != table.c.keys() or any(row.hidden for row in columns):
        raise JournalError(f"{directory / DATABASE}: the table {table.name} has other columns than perfbound's")


def _rows(connection: sa.Connection, directory: Path, name: str, there: set[str]) -> tuple[StoredFact, ...]:
    if name not in there:
        return ()  # a header alone is enough to decide the campaign again from its files
    table = tables.metadata.tables[name]
    query = sa.select(table).order_by(table.c.seq)
    try:
        return tuple(READERS[name](row) for row in connection.execute(query))
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        raise JournalError(f"{directory / DATABASE}: table {name}: a row cannot be read ({error})") from None
