"""The cause of an error of a database: its file, or the disk."""

import sqlite3
from pathlib import Path

import pytest
import sqlalchemy as sa

from perfbound.orchestrator.store.damage import naming_cause
from perfbound.schemas.errors import JournalError


def failed(code: int) -> sqlite3.OperationalError:
    """Return an error of SQLite with an extended code."""
    error = sqlite3.OperationalError("disk I/O error")
    error.sqlite_errorcode = code
    return error


@pytest.mark.parametrize("wrapped", [False, True], ids=["of the driver", "of SQLAlchemy"])
@pytest.mark.parametrize("code", [sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_IOERR | 18 << 8])
def test_a_full_or_failing_disk_is_no_fault_of_the_file(tmp_path: Path, code: int, wrapped: bool) -> None:
    with pytest.raises(OSError, match="disk I/O error") as found, naming_cause(tmp_path):
        raise sa.exc.OperationalError("SELECT", {}, failed(code)) if wrapped else failed(code)
    assert found.value.filename == str(tmp_path / "campaign.db")


@pytest.mark.parametrize("error", [failed(sqlite3.SQLITE_CORRUPT), ValueError("no number"), KeyError("F")])
def test_a_damaged_file_is_named_with_the_remedy(tmp_path: Path, error: Exception) -> None:
    line = r"campaign\.db: not a campaign database .*; restore it from a copy"
    with pytest.raises(JournalError, match=line), naming_cause(tmp_path):
        raise error


def test_a_message_that_quotes_the_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(JournalError) as found, naming_cause(tmp_path):
        raise sqlite3.DatabaseError("malformed database schema (OT NULL,\n\x1b[2J" + 1000 * "x" + ")")
    assert str(found.value).isprintable()
    assert len(str(found.value).removeprefix(str(tmp_path))) < 300


def test_what_is_neither_passes(tmp_path: Path) -> None:
    with pytest.raises(InterruptedError), naming_cause(tmp_path):
        raise InterruptedError
