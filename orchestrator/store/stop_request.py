"""The request to stop, from another process: a small file in the run directory, which the orchestrator takes away.

A file and no signal: it cannot reach a wrong process, whatever became of a process id, and it reaches an orchestrator
in a thread of another program, in a container, and on another machine that shares the folder.
"""

import contextlib
from pathlib import Path
from typing import Literal, cast, get_args

from ...schemas import atomic

NAME = "stop.request"
Manner = Literal["now", "drain"]
"""Stop at once, or after the rollouts under way."""
LONGEST = 16
"""Bytes that are read of a request at most: any process may have written it."""


def ask_to_stop(directory: Path, manner: Manner) -> None:
    """Ask the orchestrator that holds the lock of `directory` to stop.

    Raises:
        OSError: the folder cannot be written.

    """
    atomic.write_whole(directory / NAME, manner.encode())


def take_request(directory: Path) -> Manner | None:
    """Return the request and remove it; None where there is none."""
    path = directory / NAME
    if not path.is_file():  # a pipe of this name would block its reader
        return None
    try:
        with path.open("rb") as file:
            text = file.read(LONGEST).decode(errors="replace")
    except OSError:  # there is none; or the run directory has a fault, which the next write names
        return None
    withdraw_request(directory)
    # Whatever is written there asks for a stop: at once, unless it says otherwise.
    return cast("Manner", text) if text in get_args(Manner) else "now"


def is_waiting(directory: Path) -> bool:
    """Whether a request has not been taken."""
    return (directory / NAME).exists()


def withdraw_request(directory: Path) -> None:
    """Remove a request, if there is one."""
    with contextlib.suppress(OSError):
        (directory / NAME).unlink(missing_ok=True)
