"""Commands on the output of a campaign: verify, sign and export it; make keys."""

import re
import sys
from pathlib import Path
from typing import Literal

import click

from ...schemas.amounts import counted
from ...schemas.errors import PerfboundError, meant, one_line
from . import signing
from .early import check_directory
from .group import RUN_DIRECTORY, cli, output_console
from .pipes import stdout_bytes
from .stderr import STDERR


@cli.command()
@click.argument("path", type=click.Path(path_type=Path, exists=True))
@click.option("--key", type=click.Path(path_type=Path, dir_okay=False), default=None, help="The signer's public key.")
@click.option(
    "--resimulate",
    "again",
    type=click.IntRange(0),
    default=0,
    metavar="K",
    help="Simulate K rollouts or batches again.",
)
@click.option(
    "--system",
    default=None,
    metavar="REF",
    help="With --resimulate: the system, if it is in a file; FILE.py:NAME or its campaign file.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
def verify(*, path: Path, key: Path | None, again: int, system: str | None, as_json: bool) -> None:
    """Check the certificate in PATH, a run directory or a certificate, against its evidence.

    The campaign is decided again from the trajectory files alone. Exits with 1 if any check fails.
    """
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify import run, stages, table  # noqa: PLC0415

    if path.suffix == ".toml":
        raise PerfboundError(f"{path}: this is a campaign file; give its run directory, such as runs/{path.stem}")
    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        found = run.verify_certificate(path, key=key, again=again, report=stages.stage_bars(progress), system=system)
    if as_json:
        click.echo(table.as_json(found))
    else:
        table.print_verification(found, output_console())
    if not found.checks.good:
        sys.exit(1)


@cli.command()
@click.argument("name")
@click.option(
    "--out",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    default=None,
    help="Folder for the two files.  [default: ~/.config/perfbound/keys]",
)
@click.option("--passphrase", "encrypted", is_flag=True, help="Encrypt the private key with a passphrase.")
def keygen(*, name: str, out: Path | None, encrypted: bool) -> None:
    """Make a key that signs certificates: NAME.key, which is secret, and NAME.pub, for their verification."""
    from ..certificate.signing.key_folder import made_key_folder, work_tree  # noqa: PLC0415
    from ..certificate.signing.keys import new_pair  # noqa: PLC0415

    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", name):
        raise click.UsageError("NAME consists of letters, digits, '.', '_' and '-'; --out names the folder")
    secret = signing.passphrase(f"Passphrase of {name}", twice=True) if encrypted else b""
    pair = new_pair(out or made_key_folder(), name, secret)
    click.echo(f"private key  {pair.private}   keep it secret: it signs in your name")
    click.echo(f"public key   {pair.public}   give it to everyone who verifies your certificates")
    click.echo(f"key id       {pair.id}")
    if (tree := work_tree(pair.private.parent)) is not None:
        warning = (
            f"{pair.private}: is in the git work tree {tree} and may be committed; move this private key elsewhere"
        )
        click.echo(f"perfbound: {one_line(warning)}", err=True)


@cli.command()
@click.argument("directory", type=RUN_DIRECTORY)
@click.option("--key", type=signing.KEY, required=True, help="Private key, as `perfbound keygen` makes it.")
def sign(*, directory: Path, key: Path) -> None:
    """Add a signature to the certificate in DIRECTORY."""
    click.echo(signing.sign_directory(directory, signing.load_key(key)))


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
def export(
    *,
    directory: Path,
    tables: tuple[str, ...],
    out: Path | None,
    form: Literal["csv", "parquet"],
    rollouts: tuple[str, ...],
    batches: bool,
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
