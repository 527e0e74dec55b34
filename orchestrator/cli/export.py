"""The command `export`: the data of a campaign in forms that other tools read."""

import sys
from pathlib import Path
from typing import Any, Literal

import click

from ...schemas.amounts import counted
from ...schemas.errors import meant
from ...schemas.number_text import number_in
from .early import check_directory
from .group import RUN_DIRECTORY, cli, output_console
from .pipes import stdout_bytes
from .signing import load_key
from .stderr import STDERR

FILE = click.Path(path_type=Path, dir_okay=False)


def _nominal(_context: click.Context, _parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    found = dict[str, float]()
    for each in given:
        name, _, number = each.partition("=")
        try:
            found[name] = number_in(number)
        except ValueError:
            raise click.BadParameter(f"{each!r}: give NAME=VALUE, a parameter and a number") from None
    return found


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY, callback=check_directory)
@click.argument("tables", nargs=-1, metavar="[TABLES]...")
@click.option(
    "--out",
    type=click.Path(path_type=Path, allow_dash=True),
    default=None,
    help="Folder for the files, or - for one of them to stdout.  [default: DIRECTORY/export]",
)
@click.option("--format", "form", type=click.Choice(["csv", "parquet"]), default="csv", show_default=True)
@click.option(
    "--rollout",
    "rollouts",
    multiple=True,
    help="Write instead the trajectory of this rollout, for a viewer, into rollouts.mcap; may be repeated.",
)
@click.option("--batch", "batches", is_flag=True, help="With --rollout: also of all others in its batch.")
@click.option(
    "--regression",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    metavar="DIR",
    help="Write instead the failures as regression tests: a pytest file, and its table of scenarios.",
)
@click.option(
    "--campaign", type=FILE, default=None, help="With --regression: its system is replayed, with its options."
)
@click.option(
    "--groups",
    type=click.IntRange(1, 1000),
    help="With --regression: groups of near failures, at most, those with the worst ones.  [default: 10]",
)
@click.option(
    "--tests",
    type=click.IntRange(0, 10_000),
    help="With --regression: rollouts that look for the failure of a kind nearest to the nominal start.  [default: 60]",
)
@click.option(
    "--nominal",
    multiple=True,
    metavar="NAME=VALUE",
    callback=_nominal,
    help="With --regression: the nominal value of a parameter, by default the middle of its range; may be repeated.",
)
@click.option(
    "--safety-case",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    metavar="DIR",
    help="Write instead a safety case of the finished campaign: a document, a drawing and its argument.",
)
@click.option("--bundle", type=FILE, default=None, help="Write instead one zip file with all that `verify` needs.")
@click.option("--digests", is_flag=True, help="With --bundle: leave out the trajectories; their digests stay.")
@click.option(
    "--key", "signers", type=FILE, multiple=True, help="With these: public key of who has signed; may be repeated."
)
@click.option(
    "--sign", type=FILE, default=None, metavar="KEY", help="With --bundle: sign its list with this private key."
)
def export(
    *,
    directory: Path,
    tables: tuple[str, ...],
    out: Path | None,
    form: Literal["csv", "parquet"],
    rollouts: tuple[str, ...],
    batches: bool,
    regression: Path | None,
    safety_case: Path | None,
    bundle: Path | None,
    digests: bool,
    signers: tuple[Path, ...],
    sign: Path | None,
    **options: Any,
) -> None:
    """Write TABLES of the campaign in DIRECTORY as files, while it runs too.

    \b
    tests            a row a test: its expectation, its observation, the bounds after it
    rollouts         a row a rollout: its start, robustness, file, worker and times
    observations     a row a replicate: its contribution to the test
    counterexamples  those of the rollouts that violate the specification
    failures         a row a failed attempt: its worker, its reason, and whether the system failed
    opinions         a row a result that was compared, outvoted or simulated again: its worker and digest
    set_aside        a row a pause of a worker or host: its length and its reason

    Without TABLES all are written.
    """
    from ..store import export as store  # noqa: PLC0415

    if safety_case is not None or bundle is not None or signers or sign or digests:
        if bundle is None and (sign or digests or safety_case is None):
            raise click.UsageError("--digests and --sign are for --bundle; --key is for --bundle and --safety-case")
        if tables or rollouts or batches or out or form != "csv" or regression is not None or any(options.values()):
            raise click.UsageError("--safety-case and --bundle take no TABLES and no other option than theirs")
        _export_case(directory, safety_case, bundle, signers=signers, sign=sign, trajectories=not digests)
        return
    if regression is not None or any(options.values()):
        if regression is None or tables or rollouts or batches or out or form != "csv":
            raise click.UsageError(
                "--campaign, --groups, --tests and --nominal are for --regression, which takes no TABLES and no other "
                "option"
            )
        _export_regression(directory, regression, **options)
        return
    if rollouts or batches:
        if tables or not rollouts or form != "csv":
            raise click.UsageError("--rollout and --batch take no TABLES and no --format; name rollouts alone")
        _export_rollouts(directory, rollouts, out or directory / store.DEFAULT, batches=batches)
        return
    unknown = [name for name in tables if name not in store.TABLES]
    if unknown:
        near, allowed = meant(unknown[0], store.TABLES), ", ".join(store.TABLES)
        raise click.UsageError(f"there is no table {unknown[0]!r}; {near}allowed are {allowed}")
    if str(out) == "-":
        if len(tables) != 1 or form != "csv":
            raise click.UsageError("--out - writes one table, as CSV; name that table")
        with stdout_bytes() as stream:
            store.stream(directory, tables[0], stream)
        return
    with STDERR.console.status("") as status:
        found = store.export(
            directory,
            out or directory / store.DEFAULT,
            tuple(dict.fromkeys(tables)) or store.TABLES,
            form=form,
            progress=lambda name, rows: status.update(f"{name}: {rows:,} rows"),
        )
    for path, rows in found:
        click.echo(f"{path}  {counted(rows, 'row')}")


def _export_rollouts(directory: Path, rollouts: tuple[str, ...], out: Path, *, batches: bool) -> None:
    from ..report.rollout.viewer_file import viewer_file  # noqa: PLC0415
    from ..store.export import whole  # noqa: PLC0415

    with STDERR.console.status("reading the rollouts"):
        data, number = viewer_file(directory, rollouts, batches=batches)
    if str(out) == "-":
        with stdout_bytes() as stream:
            stream.write(data)
        return
    path = out / "rollouts.mcap"
    with whole(directory, [path]) as (file,):
        file.write(data)
    click.echo(f"{path}  {counted(number, 'rollout')}")


def _export_regression(
    directory: Path,
    folder: Path,
    *,
    campaign: Path | None,
    groups: int | None,
    tests: int | None,
    nominal: dict[str, float],
) -> None:
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..release.regression.export import Wanted, export_regression  # noqa: PLC0415

    if campaign is None:
        raise click.UsageError("--regression needs --campaign FILE: the tests replay its system, with its options")
    wanted = Wanted(campaign, groups or 10, 60 if tests is None else tests, nominal)
    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        lines = export_regression(directory, folder, wanted, stage_bars(progress))
    for line in lines:
        click.echo(line)


def _export_case(
    directory: Path,
    folder: Path | None,
    bundle: Path | None,
    *,
    signers: tuple[Path, ...],
    sign: Path | None,
    trajectories: bool,
) -> None:
    from rich.progress import Progress  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    from ..certificate.verify.stages import stage_bars  # noqa: PLC0415
    from ..certificate.words.console_lines import hanging  # noqa: PLC0415
    from ..release.safety_case.export import Wanted, export_case  # noqa: PLC0415

    wanted = Wanted(folder, bundle, signers, None if sign is None else load_key(sign), trajectories)
    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        answer, *lines = export_case(directory, wanted, stage_bars(progress))
    hanging(output_console(), Text(), answer)
    for line in lines:
        click.echo(line)
