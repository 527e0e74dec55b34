"""Commands on systems under test and on single rollouts."""

from pathlib import Path

import click

from .group import RUN_DIRECTORY, cli


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
    """Run one rollout of SYSTEM, an installed one or FILE.py:NAME, without workers, and write its trajectory."""
    from ..fleet import simulate  # noqa: PLC0415

    for line in simulate.simulate_once(system, start, variant, seed=seed, horizon=horizon, options=options, out=out):
        click.echo(line)


@cli.command()
@click.argument("system", required=False)
def systems(system: str | None) -> None:
    """Describe SYSTEM, or list the installed ones, with parameters, columns and options."""
    from ..fleet import simulate  # noqa: PLC0415

    for line in simulate.describe(system):
        click.echo(line)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
@click.argument("rollout")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None, help="PNG file to write.")
@click.option("--mcap", type=click.Path(path_type=Path, dir_okay=False), default=None, help="MCAP file to write.")
@click.option("--system", default=None, metavar="FILE.py:NAME", help="The system, if it is in a file.")
def replay(*, directory: Path, rollout: str, out: Path | None, mcap: Path | None, system: str | None) -> None:
    """Simulate one ROLLOUT of the campaign in DIRECTORY again, compare it with its file, and draw it.

    ROLLOUT is problem.test.variant.replicate, as in reports and file names: sim_gap.3.true.0
    """
    from ..report.replay.replay import replay_rollout  # noqa: PLC0415

    for line in replay_rollout(directory, rollout, out=out, mcap=mcap, system=system):
        click.echo(line)
