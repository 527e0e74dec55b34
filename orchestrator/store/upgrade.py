"""The upgrade of a campaign database to the present schema version, before a fact that older versions have not."""

from pathlib import Path

import sqlalchemy as sa
from sqlalchemy import Connection

from . import tables
from .journal import open_engine
from .read import read_version
from .rows import ADDED_IN, DATABASE, SCHEMA_VERSION

RULES_1 = " DEFAULT 1"
"""Campaigns of version 1 name no rules, and follow rules 1."""


def upgrade(connection: Connection, version: int) -> None:
    """Give a database the tables, columns and number of the present schema version."""
    for (table, column), since in ADDED_IN.items():
        if since > version:
            kind = tables.metadata.tables[table].c[column]
            default = f" NOT NULL{RULES_1}" if not kind.nullable else ""
            connection.exec_driver_sql(f"ALTER TABLE {table} ADD COLUMN {column} {kind.type}{default}")
    tables.metadata.create_all(connection)
    for trigger in tables.insert_only():
        connection.exec_driver_sql(trigger.replace("CREATE TRIGGER", "CREATE TRIGGER IF NOT EXISTS"))
    if version < SCHEMA_VERSION:
        unguarded(connection, tables.schema, tables.schema.update().values(version=SCHEMA_VERSION))


def unguarded(connection: Connection, table: sa.Table, change: sa.Update | sa.Delete) -> None:
    """Change an insert-only table without its triggers."""
    mine = [trigger for trigger in tables.insert_only() if f" ON {table.name} " in trigger]
    for trigger in mine:
        connection.exec_driver_sql(f"DROP TRIGGER {trigger.split()[2]}")
    connection.execute(change)
    for trigger in mine:
        connection.exec_driver_sql(trigger)


def upgraded(directory: Path) -> None:
    """Upgrade the database of a campaign, whose run directory is locked.

    Raises:
        OSError: the disk is full.

    """
    engine = open_engine(directory / DATABASE)
    try:
        with engine.begin() as connection:
            upgrade(connection, read_version(connection, directory))
    finally:
        engine.dispose()
