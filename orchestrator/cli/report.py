"""Commands that draw: the report of a campaign, and its live page."""

import shlex
from pathlib import Path

import click

from ...schemas.errors import Stopped, one_line
from ..run.address import Address
from .exits import end
from .group import RUN_DIRECTORY, cli
from .stderr import STDERR
from .web_option import web_option


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
@web_option("Where to serve it.  [default: loopback and a free port]", default=Address())
@click.option("--insecure", is_flag=True, help="Allow to serve it beyond this machine, where anyone can read it.")
def web(*, directory: Path, web: Address, insecure: bool) -> None:
    """Serve the live page of the campaign in DIRECTORY, whether it runs, is stopped, or has finished."""
    from ..run.address import bind  # noqa: PLC0415
    from ..store.rows import existing  # noqa: PLC0415

    existing(directory)
    listening, address = bind(web, insecure=insecure)
    try:
        from ..report.web.server import server  # noqa: PLC0415  (late: a port that is taken is said at once)

        page = server(directory, address, _say)
        _say(f"live page: {address.url}")
        page.run([listening])
    except Stopped as request:
        end("the live page has ended", 128 + request.signal)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
@click.option("--json", "as_json", is_flag=True, help="Print what the page shows as JSON, and write nothing.")
def report(*, directory: Path, as_json: bool) -> None:
    """Write report.html, counterexamples.csv and figures of the campaign in DIRECTORY, finished or not."""
    from ..report.data import to_json  # noqa: PLC0415
    from ..report.nominal import with_nominal  # noqa: PLC0415
    from ..report.write import tell, write, write_figures  # noqa: PLC0415

    story = tell(directory)
    if as_json:
        click.echo(to_json(story))
        return
    if story.state != "finished":
        _say(f"{directory}: the campaign is {story.state}: the report shows how far it is now")
    told = with_nominal(directory, story)
    for path in (*write(directory, told), *write_figures(directory, told)):
        click.echo(path)


def draw(directory: Path) -> None:
    """Write the page of a finished campaign; if that fails, the campaign is finished all the same."""
    try:
        from ..report.write import tell, write  # noqa: PLC0415

        write(directory, tell(directory))
    except Exception as error:  # noqa: BLE001  (whatever it is: the certificate is there, and this is a picture of it)
        again = shlex.join(["perfbound", "report", str(directory)])
        _say(one_line(f"{directory}: finished, but there is no report: {error}; try again with `{again}`"))


def _say(line: str) -> None:
    from rich.text import Text  # noqa: PLC0415

    STDERR.console.print(Text(line), soft_wrap=True)
