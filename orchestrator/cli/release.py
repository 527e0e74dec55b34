"""Commands of a release process."""

import sys
from pathlib import Path
from typing import Any

import click

from ...schemas import atomic
from .early import check_directory, check_folder
from .exits import resumable
from .group import RUN_DIRECTORY, cli, output_console
from .link_options import link_of, worker_options
from .signing import load_key
from .stderr import STDERR

FAILED, UNREADABLE = 3, 1
"""Exit codes."""
FILE = click.Path(path_type=Path, dir_okay=False)


def _each_there(context: click.Context, parameter: click.Parameter, directories: tuple[Path, ...]) -> tuple[Path, ...]:
    return tuple(check_directory(context, parameter, each) for each in directories)


@cli.command()
@click.argument(
    "directories", nargs=-1, required=True, type=RUN_DIRECTORY, metavar="DIRECTORY...", callback=_each_there
)
@click.option("--policy", type=FILE, required=True, help="The rules, a TOML file.")
@click.option("--junit", type=FILE, default=None, help="Also write them as JUnit XML.")
@click.option("--sarif", type=FILE, default=None, help="Also write what fails, and counterexamples, as SARIF 2.1.0.")
@click.option("--markdown", type=FILE, default=None, help="Also append a summary to this file, for a pull request.")
@click.option(
    "--attestation",
    type=FILE,
    default=None,
    help="Also write an in-toto test-result attestation of the certificates; with --sign in its envelope.",
)
@click.option("--sign", type=FILE, default=None, metavar="KEY", help="Sign the attestation with this private key.")
@click.option(
    "--campaign",
    "campaigns",
    type=FILE,
    multiple=True,
    help="With --sarif: a campaign file, whose lines are named; may be repeated.",
)
@click.option(
    "--system",
    default=None,
    metavar="REF",
    help="With `resimulated`: the system, if it is in a file; FILE.py:NAME or its campaign file.",
)
def gate(
    *,
    directories: tuple[Path, ...],
    policy: Path,
    junit: Path | None,
    sarif: Path | None,
    markdown: Path | None,
    attestation: Path | None,
    sign: Path | None,
    campaigns: tuple[Path, ...],
    system: str | None,
) -> None:
    """Judge the finished campaigns in each DIRECTORY by the rules of a policy.

    Exits with 0 if every rule holds, with 3 if one fails, and with 1 if a campaign or the policy cannot be read.
    """
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..release.gate import outputs  # noqa: PLC0415
    from ..release.gate.policy import load_policy  # noqa: PLC0415
    from ..release.gate.rules import judged  # noqa: PLC0415
    from ..release.gate.subject import read_subject  # noqa: PLC0415

    if sign is not None and attestation is None:
        raise click.UsageError("--sign signs the attestation: give --attestation FILE as well")
    key = None if sign is None else load_key(sign)
    rules = load_policy(policy)
    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = judged(rules, [read_subject(each, rules, system, stage_bars(progress)) for each in directories])
    outputs.print_judgements(found, output_console())
    if junit is not None:
        atomic.write_whole(junit, outputs.to_junit(found).encode())
    if sarif is not None:
        atomic.write_whole(sarif, outputs.to_sarif(found, campaigns).encode())
    if attestation is not None:
        from ..certificate.signing.sign import sign as signed  # noqa: PLC0415
        from ..release.gate.attestation import to_attestation  # noqa: PLC0415

        statement = to_attestation(found, policy, policy.read_bytes())
        atomic.write_whole(attestation, statement if key is None else signed(statement, key))
    if markdown is not None:
        with markdown.open("a", encoding="utf-8") as file:  # the summary of a job is one file for all its steps
            file.write(outputs.to_markdown(found))
    if any(each.fault for each in found):
        sys.exit(UNREADABLE)
    if not outputs.passed(found):
        sys.exit(FAILED)


def _older(_context: click.Context, _parameter: click.Parameter, given: str) -> float:
    from ...schemas.amounts import seconds_of  # noqa: PLC0415

    try:
        return seconds_of(given)
    except ValueError as error:
        raise click.BadParameter(f"{given!r}: {error}") from None


@cli.command()
@click.argument("folder", type=RUN_DIRECTORY, default="runs", callback=check_folder)
@click.option(
    "--older", required=True, metavar="AGE", callback=_older, help="Runs whose last change is older go: 36h, 30d, 2w."
)
@click.option(
    "--keep-verified", is_flag=True, help="Keep finished runs that verify; each is verified, which takes time."
)
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.option("--dry-run", is_flag=True, help="Only say what would go.")
def clean(*, folder: Path, older: float, keep_verified: bool, yes: bool, dry_run: bool) -> None:
    """Remove old run directories in FOLDER (default: runs); say first what goes, and how much it frees.

    A run that is running or signed stays, and one with files that perfbound has not written.
    """
    from rich.progress import Progress  # noqa: PLC0415

    from ...schemas.amounts import amount  # noqa: PLC0415
    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..release.clean import Judged, judge_runs, remove_runs, summary  # noqa: PLC0415

    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = judge_runs(folder, older=older, keep_verified=keep_verified, report=stage_bars(progress))
    for line in summary(found):
        click.echo(line)
    if dry_run or all(each.kept for each in found):
        return
    if not yes and not sys.stdin.isatty():
        raise click.UsageError("there is no terminal to ask: give --yes to remove them, or --dry-run")
    if not yes and not click.confirm("Remove them for good?"):
        return

    def done(each: Judged, reason: str) -> None:
        click.echo(f"stays: {each.directory}: {reason}" if reason else f"removed {each.directory}")

    click.echo(f"freed {amount(remove_runs(found, done))}")


def _equal(_context: click.Context, _parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    """Return the differences that do not matter, by their quantities."""
    from typing import get_args  # noqa: PLC0415

    from ...schemas.result.comparison import ComparedQuantity  # noqa: PLC0415

    found = dict[str, float]()
    for each in given:
        quantity, _, number = each.partition("=")
        try:
            found[quantity] = float(number)
        except ValueError:
            found[quantity] = -1.0
        if quantity not in get_args(ComparedQuantity) or not 0.0 < found[quantity] < float("inf"):
            names = ", ".join(get_args(ComparedQuantity))
            raise click.BadParameter(f"{each!r}: give QUANTITY=NUMBER, a number above 0 of {names}")
    return found


@cli.command()
@click.argument("a", type=click.Path(path_type=Path, exists=True), metavar="A")
@click.argument("b", type=click.Path(path_type=Path, exists=True), metavar="B")
@click.option("--out", type=RUN_DIRECTORY, required=True, help="Folder of the comparison.")
@click.option(
    "--pairs",
    type=click.IntRange(2, 1_000_000),
    default=None,
    help="Starts, each with a rollout of A and one of B; with --stop-when the largest number.  [default: 1000]",
)
@click.option(
    "--delta",
    type=click.FloatRange(1e-9, 0.5),
    default=0.05,
    show_default=True,
    help="Failure probability of all intervals together.",
)
@click.option(
    "--equal",
    multiple=True,
    metavar="QUANTITY=NUMBER",
    callback=_equal,
    help="A difference that does not matter, of `mean`, `failure_probability`, `worst_start` or `worst_case`; may be "
    "repeated.",
)
@click.option("--stop-when", type=click.Choice(["decided"]), help="Stop as soon as no verdict is UNDECIDED.")
@click.option(
    "--worst-case",
    is_flag=True,
    help="Compare the worst starts of all: both campaigns run as their files say, each with half of --delta.",
)
@click.option(
    "--fail-on",
    type=click.Choice(["worse", "undecided"]),
    multiple=True,
    help="Exit with 3 where a difference has this verdict; may be repeated.",
)
@click.option(
    "--seed", type=click.IntRange(0, 2**53 - 1), default=None, help="Other draws.  [default: that of the files]"
)
@click.option("--workers", type=click.IntRange(0, 256), default=2, show_default=True, help="Local worker processes.")
@worker_options
def compare(
    *,
    a: Path,
    b: Path,
    out: Path,
    pairs: int | None,
    delta: float,
    equal: dict[Any, float],
    stop_when: str | None,
    worst_case: bool,
    fail_on: tuple[str, ...],
    seed: int | None,
    workers: int,
    **options: Any,
) -> None:
    """Compare the systems of two campaigns by new rollouts in pairs: is B worse than A?

    A and B are campaign files, or run directories, whose campaigns are taken. The same command continues a comparison.
    """
    from ..release.compare.systems import compared, paired  # noqa: PLC0415
    from ..run.options import RunOptions  # noqa: PLC0415

    if worst_case and (pairs is not None or stop_when is not None):
        raise click.UsageError("--worst-case has no pairs: leave out --pairs and --stop-when")
    given = compared(a), compared(b)
    systems = paired(*given, seed)  # of the worst case, too: only one question has a comparison
    from ..release.compare import outputs  # noqa: PLC0415
    from ..release.compare.conduct import Terms, compare_pairs  # noqa: PLC0415
    from ..release.compare.worst_case import bounded, compare_worst  # noqa: PLC0415

    terms = Terms(pairs or 1000, delta, equal, until_decided=stop_when is not None)
    settings = RunOptions(workers, link_of(**options))
    with resumable(out, "the same command"):
        if worst_case:
            found = compare_worst(bounded(given, seed, delta), out, terms, settings, STDERR.console)
        else:
            found = compare_pairs(systems, out, terms, settings, STDERR.console)
    outputs.print_comparison(found, output_console())
    if {each.verdict.lower() for each in found.differences} & set(fail_on):
        sys.exit(FAILED)


@cli.command()
@click.argument("folder", type=RUN_DIRECTORY, default="runs", callback=check_folder)
@click.option("--requirement", default=None, metavar="ID", help="Id or name.  [default: the whole specification]")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object a line.")
def history(*, folder: Path, requirement: str | None, as_json: bool) -> None:
    """Show what the finished campaigns in FOLDER (default: runs) have shown of a requirement, the oldest first."""
    import json  # noqa: PLC0415
    from dataclasses import asdict  # noqa: PLC0415

    from ..release import history as versions  # noqa: PLC0415

    found = versions.history(folder, requirement)
    if as_json:
        for each in found.versions:
            click.echo(json.dumps({**asdict(each), "directory": str(each.directory)}))
    else:
        versions.print_history(found, output_console())
