"""The key of commands that sign, and the question for its passphrase."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

FROM_FILE = "PERFBOUND_PASSPHRASE_FILE"
"""Environment variable with the file of a passphrase. A variable with its text would show it in process lists."""
KEY = click.Path(path_type=Path)

sign_option = click.option(
    "--sign", type=KEY, default=None, metavar="KEY", help="Sign the certificate with this private key."
)


def load_key(path: Path) -> "Ed25519PrivateKey":
    """Return the private key for a signature.

    Raises:
        SignatureError: it cannot be used.

    """
    from ..certificate.signing.keys import load_private  # noqa: PLC0415

    return load_private(path, lambda: passphrase(f"Passphrase of {path}"))


def passphrase(question: str, *, twice: bool = False) -> bytes:
    """Return the passphrase from the file that the environment names, or from the terminal.

    Raises:
        SignatureError: stdin is no terminal and no file is named.

    """
    from ...schemas.errors import SignatureError  # noqa: PLC0415
    from ..certificate.signing.keys import read_passphrase  # noqa: PLC0415

    path = os.environ.get(FROM_FILE)
    if path:
        return read_passphrase(Path(path))
    if not sys.stdin.isatty():
        raise SignatureError(f"a passphrase is needed and this is no terminal; name its file in {FROM_FILE}")
    return str(click.prompt(question, hide_input=True, confirmation_prompt=twice, err=True)).encode()


def sign_directory(directory: Path, key: "Ed25519PrivateKey") -> str:
    """Sign the certificate in `directory`; return a line for the user."""
    from ..certificate.signing.keys import key_id  # noqa: PLC0415
    from ..certificate.signing.sign import sign_certificate  # noqa: PLC0415

    return f"signed       {sign_certificate(directory, key)}, key {key_id(key.public_key())}"
