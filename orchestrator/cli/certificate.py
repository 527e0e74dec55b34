"""Commands on the certificate of a campaign: verify and sign it; make keys."""

import re
import sys
from pathlib import Path

import click

from ...schemas.errors import PerfboundError, one_line
from . import signing
from .group import RUN_DIRECTORY, cli, output_console
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
    """Check the certificate in PATH, a run directory, a certificate or a bundle, against its evidence.

    The campaign is decided again from the trajectory files alone. Exits with 1 if any check fails.
    """
    from rich.progress import Progress  # noqa: PLC0415

    from ..certificate.verify import run, stages, table  # noqa: PLC0415
    from ..release.safety_case.bundle import is_bundle, verify_bundle  # noqa: PLC0415

    if path.suffix == ".toml":
        raise PerfboundError(f"{path}: this is a campaign file; give its run directory, such as runs/{path.stem}")
    with Progress(console=STDERR.console, transient=True, disable=not sys.stderr.isatty()) as progress:
        verified = verify_bundle if is_bundle(path) else run.verify_certificate
        found = verified(path, key=key, again=again, report=stages.stage_bars(progress), system=system)
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
