"""Commands that run campaigns and show their progress."""

import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...schemas.errors import one_line
from . import signing
from .early import check_campaign, check_directory
from .exits import resumable
from .group import RUN_DIRECTORY, cli, output_console
from .link_options import link_of, link_options
from .report import draw
from .stderr import STDERR

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from ...schemas.result.known import CampaignVerdict

REFUTED = 3
"""Exit code with --strict."""
SEEDS = click.IntRange(0, 10_000)


out_option = click.option("--out", type=RUN_DIRECTORY, default=None, help="Run directory.  [default: runs/<name>]")
seed_option = click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=None, help="Override the file's seed.")
counterexample_option = click.option(
    "--until-counterexample",
    is_flag=True,
    help="End the campaign with the first test that violates the specification, as the key of the file does.",
)
drain_option = click.option(
    "--drain",
    is_flag=True,
    help="On Ctrl-C or SIGTERM let the rollouts under way end first; a second one stops at once.",
)
strict_option = click.option(
    "--strict", is_flag=True, help="Exit with 3 when an assumption of the first claim is refuted."
)


on_finish_option = click.option(
    "--on-finish",
    default=None,
    metavar="COMMAND",
    help="Run COMMAND when the certificate is issued, with the verdict as JSON on its stdin.",
)


def _log(_context: click.Context, _option: click.Parameter, form: str) -> None:
    if form == "json":
        STDERR.as_json()


log_option = click.option(
    "--log",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    callback=_log,
    is_eager=True,  # before the arguments, whose faults are lines of this form
    expose_value=False,
    help="Form of progress and errors on stderr; json is one object a line.",
)
campaign_argument = click.argument("campaign", type=click.Path(path_type=Path), callback=check_campaign)


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
@counterexample_option
@signing.sign_option
@strict_option
@on_finish_option
@drain_option
@log_option
@link_options
def run(
    *, campaign: Path, workers: int, out: Path | None, seed: int | None, until_counterexample: bool, **options: Any
) -> None:
    """Run the campaign of a CAMPAIGN file with local workers, and issue its certificate."""
    _run_new(campaign, workers, out, _overrides(seed, until_counterexample=until_counterexample), **options)


@cli.command()
@campaign_argument
@out_option
@seed_option
@counterexample_option
@signing.sign_option
@strict_option
@on_finish_option
@drain_option
@log_option
@link_options
def orchestrate(
    *, campaign: Path, out: Path | None, seed: int | None, until_counterexample: bool, **options: Any
) -> None:
    """Run a campaign with the workers that connect, and none of its own."""
    _run_new(campaign, 0, out, _overrides(seed, until_counterexample=until_counterexample), **options)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.option("--system", default=None, metavar="FILE.py:NAME", help="The system in a file, if it is elsewhere now.")
@click.option(
    "--max-tests",
    type=click.IntRange(2, 1_000_000),
    default=None,
    metavar="N",
    help="Continue a finished campaign that ended by its budget, up to N tests per problem; for methods whose bounds "
    "hold after every test.",
)
@click.option(
    "--workers",
    type=click.IntRange(0, 256),
    default=None,
    help="Local worker processes.  [default: those of the last session with --connect or --listen, else 2]",
)
@signing.sign_option
@strict_option
@on_finish_option
@drain_option
@log_option
@link_options
def resume(
    *,
    directory: Path,
    system: str | None,
    max_tests: int | None,
    workers: int | None,
    sign: Path | None,
    strict: bool,
    on_finish: str | None,
    drain: bool,
    **link: Any,
) -> None:
    """Continue the campaign in DIRECTORY from its database; print the certificate of a finished one."""
    from ..run import continuation, session  # noqa: PLC0415
    from ..run.options import RunOptions  # noqa: PLC0415

    key, way = signing.load_key(sign) if sign else None, link_of(**link)
    local = continuation.local_workers(directory, workers, way.options, extends=max_tests is not None)
    options = RunOptions(local, way, drain, system)
    with resumable(directory, options=options.resume_options):
        resumed = session.resume_campaign(directory, options, STDERR.console, max_tests)
        finish(directory, key, strict=strict, on_finish=on_finish, report=resumed)


def _run_new(
    campaign: Path,
    workers: int,
    out: Path | None,
    overrides: Mapping[str, Any],
    *,
    sign: Path | None,
    drain: bool,
    **options: Any,
) -> None:
    from ...schemas.file.reader import load_campaign  # noqa: PLC0415

    # Before hours of work: a wrong passphrase must not be noticed at their end.
    key = signing.load_key(sign) if sign else None
    config = load_campaign(campaign, **overrides)
    from ..run import session  # noqa: PLC0415  (late: a fault of the file is reported before it is loaded)
    from ..run.options import RunOptions  # noqa: PLC0415

    directory = out or Path("runs") / config.name
    at_end = {name: options.pop(name) for name in ("strict", "on_finish")}
    settings = RunOptions(workers, link_of(**options), drain)
    with resumable(directory, options=settings.resume_options):
        session.start_campaign(config, campaign, directory, settings, STDERR.console)
        finish(directory, key, **at_end, report=True)


def _overrides(seed: int | None, *, until_counterexample: bool) -> dict[str, Any]:
    """Return the keys of the file that the command line sets."""
    return ({} if seed is None else {"seed": seed}) | ({"until_counterexample": True} if until_counterexample else {})


def finish(
    directory: Path, key: "Ed25519PrivateKey | None", *, strict: bool, on_finish: str | None, report: bool
) -> None:
    """Sign and draw a finished campaign, print its end, and exit by what was asked of it."""
    from ..run.directory import finished_certificate  # noqa: PLC0415
    from ..store.read import stored_header  # noqa: PLC0415
    from .result import print_end  # noqa: PLC0415

    console, found = output_console(), finished_certificate(directory)
    if key is not None:
        signing.sign_directory(directory, key)
    if report:
        draw(directory)
    header = stored_header(directory)
    verdict = print_end(directory, header, found, console)
    if on_finish is not None and report:
        _tell(on_finish, verdict)
    if strict and found.predicate.claims[0].refuted:
        sys.exit(REFUTED)


def _tell(command: str, verdict: "CampaignVerdict") -> None:
    """Run a command of the user with the verdict on its stdin; what it prints goes to stderr."""
    try:
        ended = subprocess.run(
            shlex.split(command), input=verdict.model_dump_json(), text=True, stdout=sys.stderr, check=False
        )
        fault = f"exit code {ended.returncode}" if ended.returncode else ""
    except (OSError, ValueError) as error:
        fault = getattr(error, "strerror", None) or str(error)
    if fault:
        STDERR.fail(f"perfbound: --on-finish {one_line(command)}: {one_line(fault)}; the certificate stands")


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.argument("rollout")
@click.option("--reason", required=True, metavar="TEXT", help="The reason, for the certificate.")
def discard(directory: Path, rollout: str, reason: str) -> None:
    """Discard a recorded ROLLOUT of the campaign in DIRECTORY from which its objective cannot be computed.

    Its file is kept, the certificate names it, and `perfbound resume` simulates it again with the same seed. Every
    other rollout is evidence, and is refused.
    """
    from ..run.continuation import continue_command  # noqa: PLC0415
    from ..run.discard import discard_rollout  # noqa: PLC0415

    again = shlex.join(["perfbound", "discard", str(directory), rollout, "--reason", reason])
    with resumable(directory, again):
        found = discard_rollout(directory, rollout, reason)
    click.echo(f"discarded {found.rollout}; its file is kept in {directory / found.path}")
    click.echo(f"`{continue_command(directory)}` simulates it again")


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object, with the verdict so far.")
def status(*, directory: Path, as_json: bool) -> None:
    """Show the progress of the campaign in DIRECTORY, while it runs and afterwards."""
    import json  # noqa: PLC0415

    from . import status as view  # noqa: PLC0415

    if as_json:
        click.echo(json.dumps(view.status_object(directory)))
    else:
        console = output_console()
        # A campaign of a million rollouts, or of planned tests, takes seconds.
        with STDERR.console.status("reading the campaign"), console.capture() as text:
            view.print_status(directory, console)
        click.echo(text.get(), nl=False, color=True)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.option("--assumptions", is_flag=True, help="Also list every assumption with its status.")
def show(*, directory: Path, assumptions: bool) -> None:
    """Show everything about the finished campaign in DIRECTORY: its verdict, claims, problems and files."""
    from ..run.directory import finished_certificate  # noqa: PLC0415
    from ..store.read import stored_header  # noqa: PLC0415
    from .result import print_everything  # noqa: PLC0415

    header, console = stored_header(directory), output_console()
    print_everything(directory, header, finished_certificate(directory), console, assumptions=assumptions)


@cli.command("list")
@click.argument("folder", type=RUN_DIRECTORY, default="runs")
@click.option(
    "--search", default="", metavar="TEXT", help="Those alone that have TEXT in name, folder, state or verdict."
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object a line.")
def list_campaigns(*, folder: Path, search: str, as_json: bool) -> None:
    """List the campaigns in FOLDER (default: runs) and below, each with its verdict; the last one first."""
    import json  # noqa: PLC0415
    import time  # noqa: PLC0415
    from dataclasses import asdict  # noqa: PLC0415

    from ..report.listing import campaigns_below, listing  # noqa: PLC0415

    found = [each for each in campaigns_below(folder) if each.has(search)]
    if as_json:
        for each in found:
            click.echo(json.dumps({**asdict(each), "directory": str(each.directory)}))
    elif found:
        console = output_console()
        for line in listing(found, time.time()):
            console.print(line, soft_wrap=True)
    else:
        click.echo(f"no campaign{f' with {search!r}' if search else ''} in {folder}")


@cli.group()
def reproduce() -> None:
    """Regenerate the results of a publication."""


@reproduce.command()
@click.option("--out", type=RUN_DIRECTORY, required=True, help="Folder for tables, figures and run directories.")
@click.option("--campaigns", type=RUN_DIRECTORY, default=None, help="Campaign files.  [default: deploy/campaigns]")
@workers_option(1)
@click.option("--functions", type=SEEDS, default=50, show_default=True, help="Seeds of the test function.")
@click.option("--seeds", type=SEEDS, default=8, show_default=True, help="Seeds of the Segway with its gap.")
@click.option("--direct-seeds", type=SEEDS, default=4, show_default=True, help="Seeds of the Segway tested directly.")
@click.option(
    "--ours/--no-ours", default=True, show_default=True, help="Also make the two claims that go beyond the paper."
)
def paper(*, out: Path, campaigns: Path | None, workers: int, **extent: Any) -> None:
    """Run the campaigns of the method paper, and write its table and figures.

    Finished campaigns are not run again, and interrupted ones are resumed.
    """
    from ..report.paper import study  # noqa: PLC0415
    from ..report.paper.reproduce import reproduce_paper  # noqa: PLC0415

    with resumable(out, shlex.join(["perfbound", *sys.argv[1:]])):
        for line in reproduce_paper(
            study.Extent(**extent), campaigns or study.SHIPPED, out, workers=workers, console=STDERR.console
        ):
            click.echo(line)
