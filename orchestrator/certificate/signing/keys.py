"""Ed25519 keys in PEM files: a private one for the signer (PKCS#8), a public one for every recipient."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from ....schemas import atomic
from ....schemas.base import digest
from ....schemas.errors import SignatureError
from ....schemas.outside import exposed, read_with_status

MAX_FILE = 64 * 1024
"""Bytes of a key's file."""
ENCRYPTED = b"-----BEGIN ENCRYPTED PRIVATE KEY-----"


@dataclass(frozen=True, slots=True)
class Pair:
    """A new key: where its two files are, and its id."""

    private: Path
    public: Path
    id: str


def key_id(key: Ed25519PublicKey) -> str:
    """Return the name of a key, as securesystemslib computes it: sha256 of its canonical JSON, 64 digits."""
    return digest({"keytype": "ed25519", "scheme": "ed25519", "keyval": {"public": key.public_bytes_raw().hex()}})


def new_pair(folder: Path, name: str, passphrase: bytes = b"") -> Pair:
    """Make a key: NAME.key for its owner alone (mode 0600), encrypted if there is a passphrase, and NAME.pub.

    Raises:
        SignatureError: one of the files exists already, or they cannot be written; then none of them is.

    """
    key = Ed25519PrivateKey.generate()
    cipher = BestAvailableEncryption(passphrase) if passphrase else NoEncryption()
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, cipher)
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    pair = Pair(folder / f"{name}.key", folder / f"{name}.pub", key_id(key.public_key()))
    try:
        atomic.write_new({pair.private: (secret, 0o600), pair.public: (public, 0o644)})
    except OSError as error:
        raise _refusal(error, pair.private) from None
    return pair


def load_private(path: Path, passphrase: Callable[[], bytes] = bytes) -> Ed25519PrivateKey:
    """Read a private key; `passphrase` is called if it is encrypted.

    Raises:
        SignatureError: it cannot be read, others can read it too, or it is no private Ed25519 key.

    """
    data, status = _read(path)
    # Before the permissions: a public key in its place is the likelier mistake, and may be readable by all.
    if b"PUBLIC KEY" in data:
        raise SignatureError(f"{path}: this is a public key; sign with the private one (NAME.key)")
    _check_private(path, status)
    try:
        key = load_pem_private_key(data, passphrase() if ENCRYPTED in data else None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        if ENCRYPTED in data:
            raise SignatureError(f"{path}: not the passphrase of this key; give the right one") from None
        raise SignatureError(f"{path}: not a private key (PKCS#8 PEM); make one with `perfbound keygen NAME`") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise _another_kind(path)
    return key


def load_public(path: Path) -> Ed25519PublicKey:
    """Read a public key.

    Raises:
        SignatureError: it cannot be read, or is no public Ed25519 key.

    """
    data, _ = _read(path)
    if b"PRIVATE KEY" in data:
        raise SignatureError(f"{path}: this is a private key; check with the public one (NAME.pub)")
    try:
        key = load_pem_public_key(data)
    except (ValueError, UnsupportedAlgorithm):
        raise SignatureError(f"{path}: not a public key (PEM); ask the signer for the .pub file") from None
    if not isinstance(key, Ed25519PublicKey):
        raise _another_kind(path)
    return key


def read_passphrase(path: Path) -> bytes:
    """Return the first line of a passphrase file, which its owner alone may read.

    Raises:
        SignatureError: it cannot be read, others can read it too, or there is no passphrase in it.

    """
    data, status = _read(path)
    _check_private(path, status)
    line = data.splitlines()[0]
    if not line:
        raise SignatureError(f"{path}: its first line is empty; write the passphrase there")
    return line


def _another_kind(path: Path) -> SignatureError:
    return SignatureError(f"{path}: not an Ed25519 key; make one with `perfbound keygen NAME`")


def _read(path: Path) -> tuple[bytes, os.stat_result]:
    try:
        data, status = read_with_status(path, MAX_FILE)
    except OSError as error:
        raise SignatureError(f"{path}: {error.strerror}; make a key with `perfbound keygen NAME`") from None
    if not data:
        raise SignatureError(f"{path}: empty; make a key with `perfbound keygen NAME`")
    return data, status


def _check_private(path: Path, status: os.stat_result) -> None:
    """Refuse a file that others can read, as ssh does: one's own by any other user, another owner's by all users."""
    if exposed(status):
        raise SignatureError(
            f"{path}: others can read this file (mode {status.st_mode & 0o777:04o}); run `chmod 600` on it, "
            "and make a new key if this one may have been read"
        )


def _refusal(error: OSError, path: Path) -> SignatureError:
    if isinstance(error, FileExistsError):
        return SignatureError(f"{error.filename2}: exists already, and a key is never overwritten; choose another name")
    return SignatureError(f"{path.parent}: no key can be written here ({error.strerror}); choose another --out")
