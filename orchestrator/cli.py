"""The command line: thin, and quick to start; what is heavy is imported inside the commands."""

import os

# One BLAS thread: a certificate must not depend on the number of cores. Read once, when numpy loads.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import errno
import signal
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from orchestrator.errors import PerfboundError, Stopped
from schemas import __version__
from schemas.link import LOCAL

if TYPE_CHECKING:
    from orchestrator.session import Link

RUN_DIRECTORY = click.Path(path_type=Path, file_okay=False)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="perfbound")
def cli() -> None:
    """Test campaigns for safety-critical systems that end with a certificate."""


def link_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say where to listen for workers."""
    for option in (
        click.option("--tls-key", default=None, help="PEM file of our private key."),
        click.option("--tls-certificate", default=None, help="PEM file of our certificate."),
        click.option("--tls-ca", default=None, help="PEM file of the authority that signed both sides' certificates."),
        click.option("--insecure", is_flag=True, help="Allow to listen beyond this machine without TLS."),
        click.option("--listen", "endpoint", default=LOCAL, show_default=True, help="Endpoint for workers."),
    ):
        command = option(command)
    return command


out_option = click.option("--out", type=RUN_DIRECTORY, default=None, help="Run directory.  [default: runs/<name>]")
seed_option = click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=None, help="Override the file's seed.")
campaign_argument = click.argument("campaign", type=click.Path(path_type=Path))


def workers_option(least: int) -> Callable[..., Any]:
    """Return the option for the number of local workers."""
    return click.option(
        "--workers", type=click.IntRange(least, 256), default=2, show_default=True, help="Local worker processes."
    )


@cli.command()
@campaign_argument
@workers_option(1)
@out_option
@seed_option
@link_options
def run(campaign: Path, workers: int, out: Path | None, seed: int | None, **link: Any) -> None:
    """Run the campaign of a CAMPAIGN file with local workers, and issue its certificate."""
    _start(campaign, workers, out, seed, link)


@cli.command()
@campaign_argument
@out_option
@seed_option
@link_options
def orchestrate(campaign: Path, out: Path | None, seed: int | None, **link: Any) -> None:
    """Run a campaign with the workers that connect, and none of its own."""
    _start(campaign, 0, out, seed, link)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
@workers_option(0)
@link_options
def resume(directory: Path, workers: int, **link: Any) -> None:
    """Continue the campaign in DIRECTORY from its database; print the certificate of a finished one."""
    from orchestrator import session  # noqa: PLC0415

    with _stoppable(directory):
        session.resume(directory, workers=workers, link=_link(**link), console=_talk())
    _finish(directory)


def _start(campaign: Path, workers: int, out: Path | None, seed: int | None, link: dict[str, Any]) -> None:
    from orchestrator import session  # noqa: PLC0415

    with _stoppable(None) as told:
        config = session.load(campaign)
        directory = out or Path("runs") / config.name
        told.append(directory)
        session.start(campaign, workers=workers, out=directory, seed=seed, link=_link(**link), console=_talk())
    _finish(directory)


def _finish(directory: Path) -> None:
    from rich.console import Console  # noqa: PLC0415

    from orchestrator import session, terminal  # noqa: PLC0415

    console = Console(soft_wrap=True)
    terminal.summary(session.certificate(directory), console)
    terminal.written(directory, console)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
def status(directory: Path) -> None:
    """Show how far the campaign in DIRECTORY is, while it runs and afterwards."""
    from rich.console import Console  # noqa: PLC0415

    from orchestrator import status as view  # noqa: PLC0415

    view.show(directory, Console(soft_wrap=True))


@cli.command()
@click.argument("system")
@click.option("--x", "start", required=True, help="Starting condition, one number per parameter: 5,0")
@click.option("--variant", type=click.Choice(["nominal", "true"]), default="nominal", show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=0, show_default=True)
@click.option("--horizon", type=click.FloatRange(0, 86_400), default=15.0, show_default=True, help="Seconds.")
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Option of the system; may be repeated.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="MCAP file to write.")
def simulate(
    system: str, start: str, variant: str, seed: int, horizon: float, options: tuple[str, ...], out: Path
) -> None:
    """Run one rollout of SYSTEM without workers, and write its trajectory."""
    from orchestrator import single  # noqa: PLC0415

    for line in single.simulate(system, start, variant, seed, horizon, options, out):
        click.echo(line)


@cli.command()
def systems() -> None:
    """List the installed systems with their parameters, columns and options."""
    from orchestrator import single  # noqa: PLC0415

    for line in single.describe():
        click.echo(line)


def _talk() -> Any:
    from rich.console import Console  # noqa: PLC0415

    return Console(stderr=True)


def _link(
    endpoint: str, *, insecure: bool, tls_ca: str | None, tls_certificate: str | None, tls_key: str | None
) -> "Link":
    from orchestrator.session import Link  # noqa: PLC0415
    from schemas.link import Tls  # noqa: PLC0415

    files = (tls_ca, tls_certificate, tls_key)
    if not any(files):
        return Link(endpoint, None, insecure)
    if tls_ca is None or tls_certificate is None or tls_key is None:
        raise click.UsageError("--tls-ca, --tls-certificate and --tls-key belong together")
    return Link(endpoint, Tls(ca=tls_ca, certificate=tls_certificate, key=tls_key), insecure)


@contextmanager
def _stoppable(directory: Path | None) -> Iterator[list[Path]]:
    """Turn SIGINT and SIGTERM into a clean stop that names the way to go on."""
    told = [] if directory is None else [directory]

    def stop(number: int, _frame: FrameType | None) -> None:
        raise Stopped(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        yield told
    except Stopped as request:
        resumable = bool(told) and (told[0] / "campaign.db").exists()
        way = f"go on with: perfbound resume {told[0]}" if resumable else "nothing was started"
        click.echo(f"perfbound: stopped; {way}", err=True)
        sys.exit(128 + request.signal)


def main() -> None:
    """`perfbound`: a known error is one line on stderr and exit code 1."""
    from schemas.campaign import CampaignError  # noqa: PLC0415

    try:
        cli(prog_name="perfbound")
    except (PerfboundError, CampaignError) as error:
        _fail(str(error))
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EIO):
            raise
        where = f"{error.filename}: " if error.filename else ""
        _fail(f"{where}{error.strerror}; mend that, then continue with `perfbound resume`")
    except Exception as error:
        cause = getattr(error, "orig", None)
        if not isinstance(cause, sqlite3.Error):
            raise
        _fail(f"campaign database: {cause}; mend that, then continue with `perfbound resume`")


def _fail(message: str) -> None:
    click.echo(f"perfbound: {message}", err=True)
    sys.exit(1)
