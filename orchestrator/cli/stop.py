"""`perfbound stop`: asks the orchestrator of a run directory to stop, and waits until it has."""

import os
import time
from pathlib import Path

import click

from ...schemas.errors import PerfboundError
from ...schemas.host import host_name
from ..store import lock, stop_request
from .early import check_directory
from .group import RUN_DIRECTORY, cli

PATIENCE = 60.0
"""Seconds in which an orchestrator stops: a turn of its loop, and the end of its workers."""
PATIENCE_WITH_DRAIN = 900.0
"""Seconds with --drain: rollouts under way may take until their deadline, 600 s by default."""
PERIOD = 0.05
"""Seconds between two glances at the lock."""


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.option("--drain", is_flag=True, help="Let the rollouts under way end first, and record them.")
@click.option(
    "--wait",
    type=click.FloatRange(0, 86_400),
    default=None,
    metavar="SECONDS",
    help=f"How long to wait for its end.  [default: {PATIENCE:g}, with --drain {PATIENCE_WITH_DRAIN:g}]",
)
def stop(*, directory: Path, drain: bool, wait: float | None) -> None:
    """Stop the campaign in DIRECTORY, which another process runs, as Ctrl-C there does; `resume` continues it."""
    limit = wait if wait is not None else PATIENCE_WITH_DRAIN if drain else PATIENCE
    if not lock.is_held(directory):
        raise PerfboundError(f"{directory}: {_why_not_running(directory)}")
    try:
        stop_request.ask_to_stop(directory, "drain" if drain else "now")
    except PermissionError as error:
        raise PerfboundError(
            f"{directory}: {error.strerror or error}; its orchestrator belongs to another user, who can stop it"
        ) from None
    if not _has_ended(directory, limit):
        raise PerfboundError(f"{directory}: {_why_not_ended(directory, limit)}")
    # An orchestrator that ended before it took the request has left it.
    stop_request.withdraw_request(directory)
    click.echo(_end_in_words(directory))


def _has_ended(directory: Path, limit: float) -> bool:
    """Whether the orchestrator ends within `limit` s."""
    deadline = time.monotonic() + limit
    while lock.is_held(directory):
        if time.monotonic() >= deadline:
            return False
        time.sleep(PERIOD)
    return True


def _end_in_words(directory: Path) -> str:
    from ..run.continuation import continue_command  # noqa: PLC0415

    if _has_certificate(directory):
        return f"{directory}: the campaign has finished meanwhile; its certificate is there"
    return f"stopped; continue with: {continue_command(directory)}"


def _why_not_running(directory: Path) -> str:
    from ..run.continuation import continue_command  # noqa: PLC0415
    from ..store.progress import last_session  # noqa: PLC0415

    if _has_certificate(directory):
        return "the campaign has finished, nothing is left to stop"
    host, _pid = last_session(directory)
    again = continue_command(directory)
    if host is not None and host != host_name():
        return (
            f"no process of this machine runs the campaign; the last one that did was on {host}: stop it there, or "
            f"continue here with `{again}` if it has ended"
        )
    return f"no process runs the campaign, nothing is left to stop; continue it with `{again}`"


def _why_not_ended(directory: Path, limit: float) -> str:
    from ..store.progress import last_session  # noqa: PLC0415

    host, pid = last_session(directory)
    who = "its orchestrator" if host is None else f"its orchestrator, process {pid} on {host},"
    if stop_request.is_waiting(directory):
        stop_request.withdraw_request(directory)
        return (
            f"{who} has not taken the request within {limit:g} s: it is still being started, writes its certificate, "
            "or is a program that hands in rollouts itself; the request is withdrawn, call this again or end that "
            "program"
        )
    return f"{who} has taken the request and not ended within {limit:g} s; wait longer with --wait SECONDS"


def _has_certificate(directory: Path) -> bool:
    from ..certificate.files import CERTIFICATE  # noqa: PLC0415

    return os.path.exists(directory / CERTIFICATE)
