"""The ways in which a command ends early."""

import os
import signal
import sqlite3
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

from ...schemas.errors import Stopped, one_line
from .stderr import STDERR


@contextmanager
def resumable(directory: Path, again: str | None = None, *, options: Sequence[str] = ()) -> Iterator[None]:
    """Name the command that continues a campaign which ends early: `again`, or `perfbound resume` with `options`."""
    from ..run.format import resume_command  # noqa: PLC0415

    def remedy(first: str = "") -> str:
        there = again or os.path.exists(directory / "campaign.db")  # Path.exists raises if the name is too long
        return (
            f"{first}continue with: {again or resume_command(directory, options)}" if there else "nothing was started"
        )

    try:
        yield
    except Stopped as request:
        end(f"stopped; {remedy()}", code=128 + request.signal)
    except OSError as error:
        end(f"{error.filename or directory}: {error.strerror or error}; {remedy('fix this, then ')}", code=1)
    except Exception as error:
        cause = getattr(error, "orig", None)  # SQLAlchemy's wrapping
        if not isinstance(cause, sqlite3.Error):
            raise
        end(f"{directory / 'campaign.db'}: {cause}; {remedy('fix this, then ')}", code=1)


def take_signals(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    """Set the handler of SIGINT and SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def end(*reasons: str, code: int) -> NoReturn:
    """Print each reason in one line, and exit."""
    take_signals(signal.SIG_IGN)  # nothing is left to stop
    for reason in reasons:
        STDERR.fail(f"perfbound: {one_line(reason)}")
    sys.exit(code)
