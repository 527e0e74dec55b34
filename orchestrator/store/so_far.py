"""The file of what a running campaign has shown so far, beside its database: derived, rewritten, removed at the end.

Nothing of a campaign depends on it: it lets `perfbound status` and the page of another process show in no time what the
orchestrator has computed. It is not synced, and a run directory without it is whole.
"""

import contextlib
from pathlib import Path

from pydantic import ValidationError

from ...schemas import atomic
from ...schemas.result.known import SoFar

NAME = "so-far.json"
LONGEST = 2**20
"""Bytes that are read of it at most: any process may have written it."""


def write_so_far(directory: Path, found: SoFar) -> None:
    """Replace the file; a disk that is full or fails stops the campaign elsewhere, and not here."""
    path = directory / NAME
    partial = atomic.temporary(path)
    with contextlib.suppress(OSError):
        partial.write_text(found.model_dump_json())
        partial.replace(path)


def read_so_far(directory: Path) -> SoFar | None:
    """Return what an orchestrator has last written, maybe that of another run; None where there is nothing to read."""
    path = directory / NAME
    if not path.is_file():  # a pipe of this name would block its reader
        return None
    try:
        with path.open("rb") as file:
            return SoFar.model_validate_json(file.read(LONGEST))
    except (OSError, ValidationError):
        return None


def remove_so_far(directory: Path) -> None:
    """Remove the file: the certificate has everything."""
    with contextlib.suppress(OSError):
        (directory / NAME).unlink(missing_ok=True)
