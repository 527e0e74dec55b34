"""Help and remedies of every command."""

from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from perfbound.orchestrator.cli import entry  # noqa: F401  (it adds the commands)
from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.run.roster import LIVING
from perfbound.workers.cli import group, serve
from tests.facts import says


def commands(root: click.Command, *path: str) -> Iterator[tuple[click.Command, tuple[str, ...]]]:
    """Yield every command below `root`, with the words that lead to it."""
    yield root, path
    for name, each in root.commands.items() if isinstance(root, click.Group) else ():
        yield from commands(each, *path, name)


COMMANDS = [(root, path) for root in (cli, group) for _, path in commands(root)] + [(serve, ())]


@pytest.mark.parametrize(
    ("root", "path"), COMMANDS, ids=lambda each: " ".join(each) if isinstance(each, tuple) else each.name
)
def test_every_command_has_the_short_help(root: click.Command, path: tuple[str, ...]) -> None:
    short, long = (CliRunner().invoke(root, [*path, option]) for option in ("-h", "--help"))
    assert short.exit_code == 0, short.output
    assert short.stdout == long.stdout
    assert "-h, --help" in short.stdout


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("rnu", "Did you mean 'run'?"),
        ("reproduce pape", "Did you mean 'paper'?"),
        ("run c.toml --wokers 2", "'--workers'"),
        ("export DIR rolouts", "'rolouts' 'rollouts' tests rollouts"),
    ],
)
def test_a_misspelt_word_of_the_command_line_is_named_with_the_one_that_was_meant(
    tmp_path: Path, line: str, meant: str
) -> None:
    (tmp_path / "campaign.db").touch()
    found = CliRunner().invoke(cli, line.replace("DIR", str(tmp_path)).split())
    assert found.exit_code == 2
    assert says(found.stderr, meant)


@pytest.mark.parametrize("command", ["plan", "slurm"])
def test_no_command_counts_on_more_workers_than_an_orchestrator_takes(command: str) -> None:
    refused, taken = (
        CliRunner().invoke(cli, [command, "no-such.toml", "--workers", str(number)]) for number in (LIVING + 1, LIVING)
    )
    assert refused.exit_code == 2
    assert f"is not in the range 1<=x<={LIVING}" in refused.output
    assert "no-such.toml" in str(taken.exception)
