"""Numbers, time spans and commands as text."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from ....schemas.places import short_path
from ....schemas.result.facts import Header

ENDS = {
    "converged": "alpha reached",
    "budget": "budget ended",
    "refuted": "assumptions refuted",
    "counterexample": "counterexample",
}
"""Reasons why a problem ends. That its data show no more to gain is no proof that it has converged at every start."""


def figure(value: float | None, digits: int = 4) -> str:
    """Return a rounded number, or a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def duration(seconds: float) -> str:
    """Return a time span in its two largest units.

    >>> duration(75), duration(7200), duration(3)
    ('1 min 15 s', '2 h 0 min', '3 s')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def resume_command(directory: Path, options: Sequence[str] = ()) -> str:
    """Return the command that continues a campaign."""
    return shlex.join(["perfbound", "resume", str(directory), *options])


def replay_command(directory: Path, header: Header, rollout: str, system: str | None) -> str:
    """Return the command that simulates a rollout again; empty where no command can.

    A system that is not installed is named for the person who runs it: `replay` itself takes none from a run directory.
    """
    if header.spec.repeated != "anywhere":
        return ""
    named = ["--system", short_path(system)] if system is not None else []
    return shlex.join(["perfbound", "replay", str(directory), rollout, *named])
