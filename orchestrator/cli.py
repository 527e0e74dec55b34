"""The command line: thin, and quick to start; what is heavy is imported inside the commands."""

import os
import shlex
import signal
import sqlite3
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import click

from orchestrator.errors import PerfboundError, Stopped
from orchestrator.talk import TALK
from schemas import __version__

if TYPE_CHECKING:
    from orchestrator.session import Link

REFUTED = 3
"""Exit code with --strict."""
RUN_DIRECTORY = click.Path(path_type=Path, file_okay=False)
SEEDS = click.IntRange(0, 10_000)


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
        click.option(
            "--listen", "endpoint", default=None, help="Endpoint for workers.  [default: loopback and a free port]"
        ),
    ):
        command = option(command)
    return command


out_option = click.option("--out", type=RUN_DIRECTORY, default=None, help="Run directory.  [default: runs/<name>]")
seed_option = click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=None, help="Override the file's seed.")
drain_option = click.option(
    "--drain",
    is_flag=True,
    help="On Ctrl-C or SIGTERM let the rollouts under way end first; a second one stops at once.",
)
strict_option = click.option(
    "--strict", is_flag=True, help="Exit with 3 when an assumption of the first claim is refuted."
)


def _log(_context: click.Context, _option: click.Parameter, form: str) -> None:
    if form == "json":
        TALK.as_json()


log_option = click.option(
    "--log",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    callback=_log,
    expose_value=False,
    help="How to say on stderr what happens; json is one object a line.",
)
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
@strict_option
@drain_option
@log_option
@link_options
def run(*, campaign: Path, workers: int, out: Path | None, seed: int | None, **options: Any) -> None:
    """Run the campaign of a CAMPAIGN file with local workers, and issue its certificate."""
    _start(campaign, workers, out, seed, **options)


@cli.command()
@campaign_argument
@out_option
@seed_option
@strict_option
@drain_option
@log_option
@link_options
def orchestrate(*, campaign: Path, out: Path | None, seed: int | None, **options: Any) -> None:
    """Run a campaign with the workers that connect, and none of its own."""
    _start(campaign, 0, out, seed, **options)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
@workers_option(0)
@strict_option
@drain_option
@log_option
@link_options
def resume(*, directory: Path, workers: int, strict: bool, drain: bool, **link: Any) -> None:
    """Continue the campaign in DIRECTORY from its database; print the certificate of a finished one."""
    from orchestrator import session  # noqa: PLC0415

    with _resumable(directory):
        session.resume(directory, workers=workers, link=_link(**link), console=TALK.console, drain=drain)
        _finish(directory, strict=strict)


def _start(
    campaign: Path, workers: int, out: Path | None, seed: int | None, *, strict: bool, drain: bool, **link: Any
) -> None:
    from orchestrator import session  # noqa: PLC0415

    overrides = {} if seed is None else {"seed": seed}
    config = session.load(campaign, **overrides)
    directory = out or Path("runs") / config.name
    with _resumable(directory):
        session.start(
            config,
            campaign,
            workers=workers,
            directory=directory,
            link=_link(**link),
            console=TALK.console,
            drain=drain,
        )
        _finish(directory, strict=strict)


def _finish(directory: Path, *, strict: bool) -> None:
    from orchestrator import session, summary  # noqa: PLC0415

    console, found = _data(), session.certificate(directory)
    summary.show(found, console)
    summary.written(directory, console)
    if strict and found.predicate.claims[0].refuted:
        sys.exit(REFUTED)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
def status(directory: Path) -> None:
    """Show how far the campaign in DIRECTORY is, while it runs and afterwards."""
    from orchestrator import status as view  # noqa: PLC0415

    view.show(directory, _data())


@cli.command()
@click.argument("system")
@click.option("--x", "start", required=True, help="Starting condition, one number per parameter: 5,0")
@click.option("--variant", type=click.Choice(["nominal", "true"]), default="nominal", show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=0, show_default=True)
@click.option("--horizon", type=click.FloatRange(0, 86_400), default=15.0, show_default=True, help="Seconds.")
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Option of the system; may be repeated.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="MCAP file to write.")
def simulate(
    *, system: str, start: str, variant: str, seed: int, horizon: float, options: tuple[str, ...], out: Path
) -> None:
    """Run one rollout of SYSTEM without workers, and write its trajectory."""
    from orchestrator import single  # noqa: PLC0415

    for line in single.simulate(system, start, variant, seed=seed, horizon=horizon, options=options, out=out):
        click.echo(line)


@cli.command()
def systems() -> None:
    """List the installed systems with their parameters, columns and options."""
    from orchestrator import single  # noqa: PLC0415

    for line in single.describe():
        click.echo(line)


@cli.group()
def reproduce() -> None:
    """Regenerate what a publication printed."""


@reproduce.command()
@click.option("--out", type=RUN_DIRECTORY, required=True, help="Folder for tables, figures and run directories.")
@click.option("--campaigns", type=RUN_DIRECTORY, default=None, help="Campaign files.  [default: deploy/campaigns]")
@workers_option(1)
@click.option("--functions", type=SEEDS, default=50, show_default=True, help="Seeds of the test function.")
@click.option("--seeds", type=SEEDS, default=8, show_default=True, help="Seeds of the Segway with its gap.")
@click.option("--direct-seeds", type=SEEDS, default=4, show_default=True, help="Seeds of the Segway tested directly.")
@click.option("--ours/--no-ours", default=True, show_default=True, help="Also make our own two claims.")
def paper(*, out: Path, campaigns: Path | None, workers: int, **extent: Any) -> None:
    """Run the campaigns of the method paper, and write its table and figures.

    What is finished is not run again, and what was interrupted goes on where it stopped.
    """
    from orchestrator.reproduce import paper, study  # noqa: PLC0415

    with _resumable(out, shlex.join(["perfbound", *sys.argv[1:]])):
        for line in paper.reproduce(
            study.Extent(**extent), campaigns or study.SHIPPED, out, workers=workers, console=TALK.console
        ):
            click.echo(line)


def _data() -> Any:
    from rich.console import Console  # noqa: PLC0415

    return Console(soft_wrap=True, width=None if sys.stdout.isatty() else 100)


def _link(
    endpoint: str | None, *, insecure: bool, tls_ca: str | None, tls_certificate: str | None, tls_key: str | None
) -> "Link":
    from orchestrator.session import Link  # noqa: PLC0415
    from schemas.link import LOCAL, Tls  # noqa: PLC0415

    endpoint = endpoint or LOCAL
    files = (tls_ca, tls_certificate, tls_key)
    if not any(files):
        return Link(endpoint, None, insecure)
    if tls_ca is None or tls_certificate is None or tls_key is None:
        raise click.UsageError("--tls-ca, --tls-certificate and --tls-key belong together")
    return Link(endpoint, Tls(ca=tls_ca, certificate=tls_certificate, key=tls_key), insecure)


@contextmanager
def _resumable(directory: Path, again: str | None = None) -> Iterator[None]:
    """When the campaign ends before its time, name the way to go on: `again`, or to resume it."""
    from orchestrator.session import resume_command  # noqa: PLC0415

    def way(first: str = "") -> str:
        there = again or os.path.exists(directory / "campaign.db")  # Path.exists raises if the name is too long
        return f"{first}go on with: {again or resume_command(directory)}" if there else "nothing was started"

    try:
        yield
    except Stopped as request:
        _end(f"stopped; {way()}", 128 + request.signal)
    except OSError as error:
        _end(f"{error.filename or directory}: {error.strerror or error}; {way('mend that, then ')}", 1)
    except Exception as error:
        cause = getattr(error, "orig", None)  # SQLAlchemy's wrapping
        if not isinstance(cause, sqlite3.Error):
            raise
        _end(f"{directory / 'campaign.db'}: {cause}; {way('mend that, then ')}", 1)


def _take_signals(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _stop(number: int, _frame: FrameType | None) -> None:
    _take_signals(signal.SIG_IGN)  # an impatient second Ctrl-C must not break off the cleaning up
    raise Stopped(number)


def _unraisable(lost: "sys.UnraisableHookArgs") -> None:
    """Ask again for a stop that came while a destructor ran: nothing can be raised from there."""
    if isinstance(lost.exc_value, Stopped):
        _take_signals(_stop)
        threading.Timer(0.02, os.kill, (os.getpid(), lost.exc_value.signal)).start()
    else:
        sys.__unraisablehook__(lost)


def main() -> None:
    """`perfbound`: a known error is one line on stderr and exit code 1."""
    _take_signals(_stop)
    sys.unraisablehook = _unraisable
    try:
        _main()
    except Stopped as request:
        _end("stopped; nothing was started", 128 + request.signal)


def _main() -> None:
    from schemas.base import one_blas_thread  # noqa: PLC0415
    from schemas.campaign import CampaignError  # noqa: PLC0415

    one_blas_thread()
    try:
        cli(prog_name="perfbound")
    except (PerfboundError, CampaignError) as error:
        _end(str(error), 1)
    except OSError as error:
        _end(f"{error.filename or 'file system'}: {error.strerror or error}", 1)


def _end(message: str, code: int) -> NoReturn:
    from schemas.base import one_line  # noqa: PLC0415

    _take_signals(signal.SIG_IGN)  # nothing is left to stop
    TALK.fail(f"perfbound: {one_line(message)}")
    sys.exit(code)
