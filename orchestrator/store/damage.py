"""What reading a campaign database may raise: of a damaged file, or of a disk that is full or fails."""

import errno
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...schemas.errors import JournalError, OtherVersionError, one_line
from .rows import DATABASE

_UNREADABLE = (ValueError, TypeError, LookupError, ArithmeticError, RecursionError)
"""What rows of a damaged database raise besides errors of SQLite, whose messages may be no UTF-8 either."""


@contextmanager
def naming_cause(directory: Path) -> Iterator[None]:
    """Name the cause of an error of the database in `directory`.

    Raises:
        JournalError: the file is damaged, or no campaign database, or that of another perfbound.
        OSError: the disk is full or fails, which is no fault of the file.

    """
    path = directory / DATABASE
    try:
        yield
    except Exception as error:
        cause = getattr(error, "orig", None) or error  # SQLAlchemy's wrapping, which `status` does not import
        if isinstance(cause, sqlite3.DatabaseError):
            if _of_the_disk(cause):
                raise OSError(errno.EIO, str(cause), str(path)) from None
            found = str(cause)
            # Damage takes no single column away: another perfbound made these tables, whatever version they claim.
            if found.startswith("no such column"):
                raise OtherVersionError(
                    f"{path}: its tables are not those of this perfbound ({one_line(found)[:200]}); use the perfbound "
                    "that wrote it"
                ) from None
        elif isinstance(error, _UNREADABLE):
            found = f"{type(error).__name__}: {error}"
        else:
            raise
        found = one_line(found)[:200]  # which may quote the file
        raise JournalError(f"{path}: not a campaign database ({found}); restore it from a copy") from None


def _of_the_disk(error: sqlite3.Error) -> bool:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the primary code, without the detail
    return code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)
