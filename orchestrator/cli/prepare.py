"""Commands before a campaign: its first file, a system of one's own, what it will need, its constants, its system."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..prepare.init.questions import DEFAULT, IN_MANY, QUESTIONS, question_help
from .campaigns import campaign_argument, workers_option
from .early import check_reference
from .group import RUN_DIRECTORY, cli, output_console
from .slurm import MOST_WORKERS
from .stderr import STDERR

if TYPE_CHECKING:
    from ...schemas.system import Variant


@cli.command()
@click.argument("system", callback=check_reference)
@click.option(
    "--question",
    default="",
    metavar=f"[{'|'.join(QUESTIONS)}]",
    help=f"{question_help()} Default: {DEFAULT}, of more than three parameters {IN_MANY}.",
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


@cli.command("plan")
@campaign_argument
@click.option(
    "--workers", type=click.IntRange(1, MOST_WORKERS), default=2, show_default=True, help="Workers of the campaign."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object; times in s, sizes in bytes.")
def plan_command(*, campaign: Path, workers: int, as_json: bool) -> None:
    """Say what a CAMPAIGN file will need: rollouts, time, storage, memory and network, each as a range.

    Ten rollouts are simulated on this machine; nothing of them is kept, and none enters a certificate. The method of
    each problem is then rehearsed on their values, which shows how many tests it may need.
    """
    from ...schemas.file.reader import load_campaign  # noqa: PLC0415

    config = load_campaign(campaign)  # a fault of the file is reported before the numerics are loaded
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..prepare.plan.plan import plan_campaign  # noqa: PLC0415
    from ..prepare.plan.text import plan_json, print_plan  # noqa: PLC0415

    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = plan_campaign(config, campaign, workers, stage_bars(progress))
    if as_json:
        click.echo(plan_json(found, config.name))
    else:
        print_plan(found, config.name, output_console())


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
    from ..prepare.calibrate.answer import answer  # noqa: PLC0415
    from ..prepare.calibrate.calibrate import CalibrationWish  # noqa: PLC0415
    from ..prepare.calibrate.output import calibration_of, closing_lines, constants_table  # noqa: PLC0415

    folder = out or campaign.with_name(f"{campaign.stem}-calibration")
    wish = CalibrationWish(campaign, rollouts, seed, workers, campaign.with_name(f"{campaign.stem}-calibrated.toml"))
    with STDERR.console.status("calibrating") as shown:
        found = calibration_of(
            wish, folder, lambda name, done, total: shown.update(f"{name}: {done:,} of about {total:,} rollouts")
        )
    click.echo(answer(found))
    console = output_console()
    for problem in found.problems:
        if problem.constants:
            console.print(f"{problem.name}: {problem.measured.rollouts:,} rollouts", highlight=False)
            console.print(constants_table(found, problem))
    for line in closing_lines(found, folder):
        click.echo(line)


@cli.command("check-system")
@click.argument("system", callback=check_reference)
@click.option("--variant", type=click.Choice(["nominal", "true"]), default=None, help="This one alone.")
@click.option(
    "--horizon", type=click.FloatRange(0, 86_400), default=None, help="Seconds of a rollout; default: its own, or 10."
)
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Option of the system; may be repeated.")
@click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=0, show_default=True, help="Of the random starts.")
@click.option(
    "--timeout",
    type=click.FloatRange(0, 86_400, min_open=True),
    default=None,
    help="Seconds that a rollout may take; default: `deadline` of the campaign file, else 60.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check_system(
    *,
    system: str,
    variant: "Variant | None",
    horizon: float | None,
    options: tuple[str, ...],
    seed: int,
    timeout: float | None,
    as_json: bool,
) -> None:
    """Test what a certificate rests on, for SYSTEM: an installed one, FILE.py:NAME or a campaign file.

    Its rollouts run in child processes, again and in another order. Exits with 1 if any check fails; a warning is no
    failure.
    """
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..prepare.check_system import check  # noqa: PLC0415

    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = check.checked_system(
            system,
            variant=variant,
            horizon=horizon,
            options=options,
            seed=seed,
            limit=timeout,
            report=stage_bars(progress),
        )
    if as_json:
        click.echo(check.findings_json(found))
    else:
        check.print_findings(found, output_console())
    if not found.good:
        sys.exit(1)
