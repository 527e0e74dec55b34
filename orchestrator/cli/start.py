"""Commands that write the first files of a user: a campaign file, a package with a system."""

from pathlib import Path

import click

from ..prepare.init.questions import DEFAULT, QUESTIONS, question_help
from .early import check_reference
from .group import cli


@cli.command()
@click.argument("system", callback=check_reference)
@click.option(
    "--question",
    default=DEFAULT,
    metavar=f"[{'|'.join(QUESTIONS)}]",
    show_default=True,
    help=question_help(),
)
@click.option("--specification", default=None, help="Formula to test; by default a harmless one over the first column.")
@click.option("--horizon", type=click.FloatRange(0, 86_400), default=None, help="Seconds; default: the system's own.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None, help="Default: SYSTEM.toml.")
def init(*, system: str, question: str, specification: str | None, horizon: float | None, out: Path | None) -> None:
    """Write a commented campaign file for SYSTEM, an installed one or FILE.py:NAME.

    The file asks one question. A pilot of some rollouts proposes its numbers. An existing file stays as it is.
    """
    from ..prepare.init.init import Wish, write_first_campaign  # noqa: PLC0415

    for line in write_first_campaign(Wish(system, question, specification, horizon, out)):
        click.echo(line)


@cli.command("new-system")
@click.argument("name")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None, help="Folder; default: NAME.")
def new_system(*, name: str, out: Path | None) -> None:
    """Write an installable package with the system NAME, a test of it and a README.

    An existing folder stays as it is, unless it is empty.
    """
    from ..prepare.init.new_package import write_package  # noqa: PLC0415

    for line in write_package(name, out or Path(name)):
        click.echo(line)
