"""Commands of a release process."""

import sys
from pathlib import Path

import click

from ...schemas import atomic
from .early import check_directory
from .group import RUN_DIRECTORY, cli, output_console
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

    rules = load_policy(policy)
    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = judged(rules, [read_subject(each, rules, system, stage_bars(progress)) for each in directories])
    outputs.print_judgements(found, output_console())
    if junit is not None:
        atomic.write_whole(junit, outputs.to_junit(found).encode())
    if sarif is not None:
        atomic.write_whole(sarif, outputs.to_sarif(found, campaigns).encode())
    if markdown is not None:
        with markdown.open("a", encoding="utf-8") as file:  # the summary of a job is one file for all its steps
            file.write(outputs.to_markdown(found))
    if any(each.fault for each in found):
        sys.exit(UNREADABLE)
    if not outputs.passed(found):
        sys.exit(FAILED)
