"""The command that makes a campaign of logs that exist."""

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from . import signing
from .campaigns import finish, log_option, on_finish_option, out_option, strict_option
from .early import check_campaign
from .exits import resumable
from .group import cli
from .stderr import STDERR


@cli.command("import")
@click.argument("logs", type=click.Path(path_type=Path))
@click.option(
    "--starts",
    type=click.Path(path_type=Path),
    required=True,
    help="CSV file with a row for each log: its file as `log`, the start that was driven by parameter, and, where a "
    "log has several tests, the `offset` in s at which one begins.",
)
@click.option(
    "--campaign",
    type=click.Path(path_type=Path),
    required=True,
    callback=check_campaign,
    help="Campaign file with `[system] rig`, and how logs become its columns under `[system.logs]`.",
)
@out_option
@signing.sign_option
@strict_option
@on_finish_option
@log_option
def import_(*, logs: Path, starts: Path, campaign: Path, out: Path | None, sign: Path | None, **at_end: Any) -> None:
    """Make a campaign of the tests that the folder LOGS has, and issue its certificate.

    All tests that were made belong in it: to leave one out would be a choice by its outcome.
    """
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..run.imported import import_logs  # noqa: PLC0415

    key = signing.load_key(sign) if sign else None
    again = shlex.join(["perfbound", *sys.argv[1:]])
    with resumable(out or Path("runs"), again):
        with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
            directory = import_logs(campaign, logs, starts, out, stage_bars(progress))
        finish(directory, key, **at_end, report=True)
