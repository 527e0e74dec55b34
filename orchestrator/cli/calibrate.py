"""The command that proposes the constants of a campaign from rollouts of its own."""

from pathlib import Path

import click

from .campaigns import campaign_argument, workers_option
from .group import RUN_DIRECTORY, cli, output_console
from .stderr import STDERR


@cli.command()
@campaign_argument
@click.option(
    "--rollouts",
    type=click.IntRange(150, 100_000),
    default=400,
    show_default=True,
    help="Rollouts of each problem and variant; none of them enters a certificate.",
)
@click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=1, show_default=True, help="Of starts and rollouts.")
@workers_option(1)
@click.option(
    "--out", type=RUN_DIRECTORY, default=None, help="Folder for the evidence.  [default: CAMPAIGN-calibration]"
)
def calibrate(*, campaign: Path, rollouts: int, seed: int, workers: int, out: Path | None) -> None:
    """Propose the constants of a CAMPAIGN file, each with its reason, and write a campaign file with them.

    CAMPAIGN has a system, a space and a specification; constants that it has are proposed anew. The new file is beside
    it, since paths in it are relative to its folder: CAMPAIGN-calibrated.toml. Where no kernel is trustworthy, it is a
    campaign of method sample. Existing files stay as they are.
    """
    from ...schemas.file.draft import load_draft  # noqa: PLC0415

    load_draft(campaign)  # a fault of the file is reported before the numerics are loaded
    from ..prepare.calibrate.calibrate import CalibrationWish  # noqa: PLC0415
    from ..prepare.calibrate.output import calibration_of, closing_lines, constants_table  # noqa: PLC0415

    folder = out or campaign.with_name(f"{campaign.stem}-calibration")
    wish = CalibrationWish(campaign, rollouts, seed, workers, campaign.with_name(f"{campaign.stem}-calibrated.toml"))
    with STDERR.console.status("calibrating") as shown:
        found = calibration_of(
            wish, folder, lambda name, done, total: shown.update(f"{name}: {done} of about {total} rollouts")
        )
    console = output_console()
    for problem in found.problems:
        if problem.constants:
            console.print(f"{problem.name}: {problem.measured.rollouts} rollouts", highlight=False)
            console.print(constants_table(found, problem))
    for line in closing_lines(found, folder):
        click.echo(line)
