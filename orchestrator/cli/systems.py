"""Commands on systems under test and on single rollouts."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .early import check_directory, check_reference
from .group import RUN_DIRECTORY, cli

if TYPE_CHECKING:
    from ...schemas.system import Variant


@cli.command()
@click.argument("system", callback=check_reference)
@click.option("--x", "start", required=True, help="Starting condition, one number per parameter: 5,0")
@click.option("--variant", type=click.Choice(["nominal", "true"]), default="nominal", show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=0, show_default=True)
@click.option("--horizon", type=click.FloatRange(0, 86_400), default=None, help="Seconds; default: the system's own.")
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Option of the system; may be repeated.")
@click.option(
    "--disturbance",
    "disturbances",
    multiple=True,
    metavar="NAME=VALUE",
    help="Value of a disturbance, by default drawn from the seed; may be repeated.",
)
@click.option(
    "--timeout",
    type=click.FloatRange(0, 86_400, min_open=True),
    default=None,
    help="Seconds that it may take; default: `deadline` of the campaign file, else 600.",
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None, help="MCAP file to write.")
@click.option("--plot", type=click.Path(path_type=Path, dir_okay=False), default=None, help="PNG file to write.")
def simulate(
    *,
    system: str,
    start: str,
    variant: "Variant",
    seed: int,
    horizon: float | None,
    options: tuple[str, ...],
    disturbances: tuple[str, ...],
    timeout: float | None,
    out: Path | None,
    plot: Path | None,
) -> None:
    """Run one rollout of SYSTEM without workers, print the range of each column, and write or draw its trajectory.

    SYSTEM is an installed one, FILE.py:NAME or a campaign file. What the system prints goes to stderr. The exit code is
    1 for a rollout that fails or that a campaign would refuse.
    """
    from ..fleet.children.simulate import WantedRollout  # noqa: PLC0415
    from ..report.rollout.single import simulate_once  # noqa: PLC0415

    wanted = WantedRollout(system, start, variant, seed, horizon, options, timeout, disturbances)
    for line in simulate_once(wanted, out=out, plot=plot, on_line=lambda text: click.echo(text, err=True)):
        click.echo(line)


@cli.command()
@click.argument("system", required=False, callback=check_reference)
def systems(system: str | None) -> None:
    """Describe SYSTEM, or list the installed ones, with parameters, columns and options."""
    from ..fleet.children import simulate  # noqa: PLC0415

    for line in simulate.describe(system):
        click.echo(line)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.argument("rollout")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None, help="PNG file to write.")
@click.option("--mcap", type=click.Path(path_type=Path, dir_okay=False), default=None, help="MCAP file to write.")
@click.option("--system", default=None, metavar="FILE.py:NAME", help="The system, if it is in a file.")
def replay(*, directory: Path, rollout: str, out: Path | None, mcap: Path | None, system: str | None) -> None:
    """Simulate one ROLLOUT of the campaign in DIRECTORY again, compare it with its file, and draw it.

    ROLLOUT is problem.test.variant.replicate, as in reports and file names: sim_gap.3.true.0
    """
    from ..report.rollout.replay import replay_rollout  # noqa: PLC0415

    for line in replay_rollout(directory, rollout, out=out, mcap=mcap, system=system):
        click.echo(line)
