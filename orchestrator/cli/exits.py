"""The end of a command: that of its process, and the ways in which it comes early."""

import atexit
import os
import signal
import sqlite3
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

from ...schemas.errors import Stopped, one_line
from ...schemas.host import host_fault
from ...schemas.stop_signals import stop_signals
from .stderr import STDERR


@contextmanager
def process_end() -> Iterator[None]:
    """After this block, end the process without the end of Python's interpreter; what `atexit` has is done before.

    The interpreter ends its threads wherever they are. One in the compiled code of a link aborts the process then
    (exit code 134, whatever was to be said): a peer may hold up the end of a link, and a signal may interrupt it.
    """
    code = 1

    def leave() -> None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(AttributeError, OSError, ValueError):  # closed from the start, a full disk, closed since
                stream.flush()
        os._exit(code)

    atexit.register(leave)  # first, so that it is called last
    try:
        yield
        code = 0
    except SystemExit as request:
        code = request.code if isinstance(request.code, int) else int(request.code is not None)
        raise


@contextmanager
def resumable(directory: Path, again: str | None = None, *, options: Sequence[str] = ()) -> Iterator[None]:
    """Name the command that continues a campaign which ends early: `again`, or `perfbound resume` with `options`."""
    from ..certificate.words.format import resume_command  # noqa: PLC0415

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
        if (fault := host_fault(error)) is not None:
            end(f"{fault}; {remedy('then ')}", code=1)
        cause = getattr(error, "orig", None) or error  # SQLAlchemy's wrapping
        if not isinstance(cause, sqlite3.Error):
            raise
        end(f"{directory / 'campaign.db'}: {cause}; {remedy('fix this, then ')}", code=1)


def take_signals(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    """Set the handler of the signals that end a command."""
    for number in stop_signals():
        signal.signal(number, handler)


def end(*reasons: str, code: int) -> NoReturn:
    """Print each reason in one line, and exit."""
    take_signals(signal.SIG_IGN)  # nothing is left to stop
    for reason in reasons:
        STDERR.fail(f"perfbound: {one_line(reason)}")
    sys.exit(code)
