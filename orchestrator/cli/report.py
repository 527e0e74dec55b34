"""The commands of the report: its files, and the live page."""

import gc
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ...schemas.errors import Stopped
from ..run.page.address import Address
from ..run.page.page_access import PagePlace, opened
from .early import check_directory, check_folder
from .exits import end
from .group import RUN_DIRECTORY, cli
from .stderr import STDERR
from .web_option import web_options

if TYPE_CHECKING:
    from ..certificate.verify.stages import Report


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, default="runs", callback=check_folder)
@web_options("Where to serve it.  [default: loopback and a free port]", default=Address())
@click.option("--insecure", is_flag=True, help="Allow serving it beyond this machine without TLS.")
def web(*, directory: Path, web: PagePlace, insecure: bool) -> None:
    """Serve the live page of the campaign in DIRECTORY, or of all campaigns below it (default: runs)."""
    from ..store.rows import DATABASE, existing  # noqa: PLC0415

    many = not os.path.lexists(directory / DATABASE)
    if not many:
        existing(directory)
    listening, address, access = opened(web, insecure=insecure)
    try:
        from ..report.web.server import IndexServer, Server  # noqa: PLC0415  (late: a port in use is reported at once)

        server = (IndexServer if many else Server)(directory, address, _print_stderr, access)
        for line in access.lines(f"live page of the campaigns in {directory}" if many else "live page", address):
            _print_stderr(line)
        server.run([listening])
    except Stopped as request:
        end("the live page has ended", code=128 + request.signal)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.option("--json", "as_json", is_flag=True, help="Print what the page shows as JSON, and write nothing.")
def report(*, directory: Path, as_json: bool) -> None:
    """Write report.html, counterexamples.csv and figures of the campaign in DIRECTORY, finished or not."""
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415

    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        lines = _write_report(directory, as_json=as_json, report=stage_bars(progress))
    for line in lines:
        click.echo(line)


@cli.command("open")
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
def open_report(*, directory: Path) -> None:
    """Open the report of the campaign in DIRECTORY in a browser; where it has none yet, it is written first."""
    import webbrowser  # noqa: PLC0415

    from ..report.write import REPORT  # noqa: PLC0415

    page = (directory / REPORT).absolute()
    if not page.is_file():
        _write_report(directory, as_json=False, report=lambda *_: None)
    click.echo(page)
    if not webbrowser.open(page.as_uri()):
        _print_stderr("there is no browser here: copy the file to a machine with one")


def _write_report(directory: Path, *, as_json: bool, report: "Report") -> list[str]:
    """Write the report and return its files; with `as_json` write nothing, and return what the page shows."""
    report("campaign", 0, 1)
    from ..report.data.page import to_json  # noqa: PLC0415
    from ..report.rollout.nominal import with_nominal  # noqa: PLC0415
    from ..report.write import collected, write_figures, write_page  # noqa: PLC0415

    data = collected(directory)
    report("campaign", 1, 1)
    if as_json:
        return [to_json(data)]
    if data.state != "finished":
        _print_stderr(f"{directory}: the campaign is {data.state}; the report shows its present state")
    data = with_nominal(directory, data, report)
    return [str(path) for path in (*write_page(directory, data), *write_figures(directory, data, report))]


@cli.command("score")
@click.argument("directory", type=RUN_DIRECTORY)
@click.option("--specification", required=True, metavar="FORMULA", help="Formula over the columns of a trajectory.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object for each rollout.")
def score_command(*, directory: Path, specification: str, as_json: bool) -> None:
    """Score the stored rollouts of the campaign in DIRECTORY by another formula; to explore, with no certificate."""
    import json  # noqa: PLC0415
    from dataclasses import asdict  # noqa: PLC0415

    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..report.score import score_lines, scored  # noqa: PLC0415

    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = scored(directory, specification, stage_bars(progress))
    objects = (json.dumps(asdict(each)) for each in found)
    for line in objects if as_json else score_lines(directory, specification, found):
        click.echo(line)


def draw(directory: Path) -> None:
    """Write the page of a finished campaign; a failure is reported and does not fail the campaign."""
    from ..report.write import finish_page  # noqa: PLC0415

    # The state of the campaign refers to itself: of a million rollouts it would stay beside all that the report reads.
    gc.collect()
    if line := finish_page(directory):
        _print_stderr(line)


def _print_stderr(line: str) -> None:
    from rich.text import Text  # noqa: PLC0415

    STDERR.console.print(Text(line), soft_wrap=True)
