"""Rollouts before there is a campaign: in one child process, one after the other, recorded nowhere."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ...schemas.errors import PerfboundError, TrajectoryError
from ...schemas.rollout import RolloutRequest
from ...schemas.system import SystemSpec
from ...schemas.trajectory.trajectory import Trajectory, decode
from ..fleet.children.child import HangError, ask, system_options

Done = Callable[[int], None]
"""Progress callback: rollouts that are finished."""


class ChildRolloutError(PerfboundError):
    """A rollout gave no trajectory; the text names its start."""


@dataclass(frozen=True, slots=True)
class ChildSystem:
    """A system, and what its rollouts may take."""

    reference: str
    """A name, FILE.py:NAME or a campaign file."""
    spec: SystemSpec
    limit: float
    """Seconds of a rollout."""
    seconds: float
    """No rollout starts later than this after the first one."""


def simulate_in_child(
    system: ChildSystem, requests: Sequence[RolloutRequest], folder: Path, done: Done = lambda _: None
) -> None:
    """Write the file of each rollout into an empty folder, as far as they come in their time.

    Raises:
        ChildRolloutError: a rollout fails, or does not end.

    """
    listed = folder / "requests"
    listed.write_text("".join(request.model_dump_json() + "\n" for request in requests))
    place = ("--requests", str(listed), "--out", str(folder), "--seconds", str(system.seconds))
    try:
        # A file for each rollout, and before them one that says that the system is loaded.
        steps = partial(_written, folder, done)
        ask("pilot", *place, *system_options(system.reference), limit=system.limit, steps=steps)
    except PerfboundError as error:
        missing = (each for number, each in enumerate(requests) if not _file(folder, number).exists())
        failed = next(missing, requests[-1])
        hang = f"the rollout gave no result within {system.limit:g} s, and was ended"
        reason = f"{hang}{error.place}" if isinstance(error, HangError) else error
        raise ChildRolloutError(f"{failed.words(system.spec)}: {reason}") from None


def finished(
    system: ChildSystem, requests: Sequence[RolloutRequest], folder: Path
) -> Iterator[tuple[RolloutRequest, Trajectory, float]]:
    """Yield the rollouts that are in a folder, and when they were written; one at a time, since they may be large.

    Raises:
        ChildRolloutError: a file is no trajectory.

    """
    for number, request in enumerate(requests):
        path = _file(folder, number)
        if not path.exists():
            return
        try:
            trajectory = decode(path.read_bytes())
        except TrajectoryError as fault:
            raise ChildRolloutError(f"{request.words(system.spec)}: {fault}") from None
        yield request, trajectory, path.stat().st_mtime


def peak_memory(folder: Path) -> int:
    """Return the bytes of memory that the child had at most, after its rollouts."""
    return 1024 * int(_loaded(folder)["memory"])


def undeclared_files(folder: Path) -> tuple[str, ...]:
    """Return the files that the rollouts of the child have read and that are no part of the system."""
    return tuple(map(str, _loaded(folder)["opened"]))


def _loaded(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "loaded").read_text())
    return found


def _file(folder: Path, number: int) -> Path:
    return folder / f"{number}.mcap"


def _written(folder: Path, done: Done) -> int:
    files = sum(1 for _ in folder.iterdir())
    done(max(0, files - 2))  # the list of requests, and the file of a loaded system
    return files
