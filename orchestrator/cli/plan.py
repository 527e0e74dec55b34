"""The command that says what a campaign will need, before it is started."""

from pathlib import Path

import click

from .campaigns import campaign_argument
from .group import cli, output_console
from .slurm import MOST_WORKERS
from .stderr import STDERR


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
    from ..prepare.plan.plan import plan_campaign  # noqa: PLC0415
    from ..prepare.plan.text import plan_json, print_plan  # noqa: PLC0415

    with STDERR.console.status("planning") as shown:
        found = plan_campaign(config, campaign, workers, shown.update)
    if as_json:
        click.echo(plan_json(found, config.name))
    else:
        print_plan(found, config.name, output_console())
