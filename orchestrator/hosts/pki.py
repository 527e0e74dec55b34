"""The folder of a user's certificate authority: its key, its certificate, and a copy of every one that it has issued.

    ca-key.pem                 private key of the authority
    ca.pem                     its certificate
    issued/NAME-SERIAL.pem     every issued certificate, without its key
    hosts/NAME/                what the host of NAME gets, if no other folder was named

Copies of issued certificates are written first: none is in use that the list does not have.
"""

import fcntl
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from ...schemas.atomic import write_folder, write_new
from ...schemas.errors import AuthorityError, LinkError, SecretError
from ...schemas.link.secret import check_own_folder, secret_file
from ...schemas.link.tls_files import check_time, hosts_of, name_of, read_certificates, role_of
from ...schemas.outside import exposed, read_with_status
from ..certificate.signing.key_folder import work_tree
from .authority import Order, Signer, certificate_bytes, check_apart, issue_certificate, key_bytes, new_authority

if TYPE_CHECKING:
    from cryptography import x509

CA, CA_KEY, ISSUED, HOSTS = "ca.pem", "ca-key.pem", "issued", "hosts"
MAX_KEY = 64 * 1024
"""Bytes of the file of a key."""


@dataclass(frozen=True, slots=True)
class Issued:
    """A certificate that the authority has issued."""

    order: Order
    begins: datetime
    ends: datetime

    @property
    def ended(self) -> bool:
        """Whether it is of no use any more."""
        return self.ends < datetime.now(UTC)


def pki_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of this user's authority, beside the secret of this user.

    Raises:
        AuthorityError: this user has no home directory.

    """
    try:
        return secret_file(environment).parent / "pki"
    except SecretError:
        raise AuthorityError(
            "this user has no home directory for an authority; choose a folder with --folder"
        ) from None


def init_folder(folder: Path, days: int) -> datetime:
    """Make an authority in `folder`, which must not be there or be empty; return when it ends.

    Raises:
        AuthorityError: there is one already, or the folder is in a git work tree or cannot be written.

    """
    if (tree := work_tree(folder)) is not None:
        raise AuthorityError(
            f"{folder}: is in the git work tree {tree}, from which the authority's key may be published; choose a "
            "folder elsewhere with --folder"
        )
    signer = new_authority(_now(), days)
    contents = {CA_KEY: (key_bytes(signer.key), 0o600), CA: (certificate_bytes(signer.certificate), 0o644)}
    try:
        _check_beside_secret(folder)
        write_folder(folder.resolve(), contents)
    except FileExistsError:
        remedy = (
            "issue certificates of it with `perfbound pki issue`, or choose another --folder"
            if (folder / CA_KEY).exists()
            else "choose a new or empty folder with --folder"
        )
        raise AuthorityError(f"{folder}: exists already, and an authority is never overwritten; {remedy}") from None
    except OSError as error:
        raise AuthorityError(f"{folder}: cannot be made ({error.strerror}); choose another --folder") from None
    return signer.certificate.not_valid_after_utc


def issue_files(folder: Path, order: Order, days: int, out: Path | None) -> tuple[Path, Issued]:
    """Write certificate and key of a checked order, and the authority's certificate, into `out`; return its path.

    Raises:
        AuthorityError: the authority cannot be used, or the name or `out` is taken.

    """
    out = out or folder / HOSTS / order.name
    with _locked(folder):
        signer = load_signer(folder)
        known = issued(folder)
        check_apart(
            order,
            [each.order for each in known if not each.ended],
            [each.order for each in known if each.ended],
        )
        certificate, key = issue_certificate(signer, order, _now(), days)
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise _taken(out)
        pem = certificate_bytes(certificate)
        contents = {
            CA: (certificate_bytes(signer.certificate), 0o644),
            f"{order.name}.pem": (pem, 0o644),
            f"{order.name}-key.pem": (key_bytes(key), 0o600),
        }
        # The copy first: no certificate is in use that the list of issued ones does not have.
        with _with_copy(folder / ISSUED / f"{order.name}-{certificate.serial_number:x}.pem", pem):
            try:
                write_folder(out.resolve(), contents)
            except FileExistsError:
                raise _taken(out) from None
            except OSError as error:
                raise AuthorityError(f"{out}: cannot be written ({error.strerror}); choose another --out") from None
    return out, _told(certificate, order)


@contextmanager
def _with_copy(path: Path, pem: bytes) -> Iterator[None]:
    """Write the authority's copy of a certificate, and remove it if the block fails."""
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        write_new({path: (pem, 0o644)})
    except OSError as error:
        raise AuthorityError(
            f"{path.parent}: cannot be written ({error.strerror}), and lists every issued certificate; fix this folder"
        ) from None
    try:
        yield
    except AuthorityError:
        path.unlink(missing_ok=True)
        raise


def issued(folder: Path) -> list[Issued]:
    """Return what the authority has issued, by name; the certificate of a name that ends last comes last.

    Raises:
        AuthorityError: there is no authority, or a file of it is damaged.

    """
    _check_there(folder)
    found = []
    for path in sorted((folder / ISSUED).glob("*.pem")):
        try:
            certificate = read_certificates(str(path))[0]
        except LinkError:
            raise AuthorityError(f"{path}: not an issued certificate; remove this file") from None
        if (role := role_of(certificate)) is not None:
            order = Order(name_of(certificate.subject), role, tuple(hosts_of(certificate)))
            found.append(_told(certificate, order))
    return sorted(found, key=lambda each: (each.order.role, each.order.name, each.ends))


def load_signer(folder: Path) -> Signer:
    """Return the authority in a folder.

    Raises:
        AuthorityError: there is none, others could read or replace its files, or it has ended.

    """
    _check_there(folder)
    path = folder / CA_KEY
    try:
        _check_beside_secret(folder)
        status = folder.stat()
        data, of_key = read_with_status(path, MAX_KEY)
        certificate = read_certificates(str(folder / CA))[0]
        check_time(str(folder / CA), certificate)
    except OSError as error:
        raise AuthorityError(f"{path}: {error.strerror}; restore this file, or choose another --folder") from None
    except LinkError as error:
        raise AuthorityError(str(error).replace("`perfbound pki issue`", "`perfbound pki init --folder`")) from None
    if status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o022:
        raise AuthorityError(f"{folder}: others could replace the authority in it; run `chmod 700` on it as its owner")
    if exposed(of_key):
        raise AuthorityError(
            f"{path}: others can read this private key; run `chmod 600` on it, and make a new authority if it may have "
            "been read"
        )
    try:
        key = load_pem_private_key(data, None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise AuthorityError(f"{path}: not the private key of {folder / CA}; restore the two files of `pki init`")
    return Signer(certificate, key)


def _check_beside_secret(folder: Path) -> None:
    """Make the folder of this user's secret as it has to be, if the authority is in it."""
    try:
        place = secret_file().parent
    except SecretError:
        return
    if folder.resolve().parent == place.resolve():
        try:
            check_own_folder(place)
        except SecretError as error:
            raise AuthorityError(str(error)) from None


def _check_there(folder: Path) -> None:
    if not (folder / CA_KEY).exists():
        raise AuthorityError(
            f"{folder}: no certificate authority here; make one with `perfbound pki init`, or name its folder with "
            "--folder"
        )


def _taken(out: Path) -> AuthorityError:
    return AuthorityError(
        f"{out}: exists already, and a certificate is never overwritten; to renew it, choose a new folder with --out"
    )


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep other processes from issuing at the same time: their names would not be compared."""
    _check_there(folder)
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _told(certificate: "x509.Certificate", order: Order) -> Issued:
    return Issued(order, certificate.not_valid_before_utc, certificate.not_valid_after_utc)


def _now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)
