"""The command that tests a system before its campaigns."""

import sys
from typing import TYPE_CHECKING

import click

from .early import check_reference
from .group import cli, output_console
from .stderr import STDERR

if TYPE_CHECKING:
    from ...schemas.system import Variant


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
