"""Checks of the PEM files of the TLS options before a link is opened: Zenoh reports what is wrong as a timeout."""

import ipaddress
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from ..errors import LinkError, shortened
from ..outside import exposed, read_with_status

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes

MOST = 1024 * 1024
"""Bytes of a PEM file; a bundle of authorities may have hundreds of certificates."""
Role = Literal["worker", "orchestrator", "router"]
ROLES: tuple[Role, ...] = get_args(Role)
UNIT = "perfbound "
"""Before the role, in the organisational unit of a certificate that `perfbound pki` has issued."""
FIX = "fix the TLS options"


def check_link_files(ca: str, certificate: str, key: str, *, listens: bool, connects: bool) -> None:
    """Refuse files with which no link can open; what the other side alone can know is not checked.

    Raises:
        LinkError: a file is missing or of another kind, others can read the key, it is not that of the certificate, or
            the certificate is not valid now, not signed by `ca`, or not for this use.

    """
    for path in (ca, certificate, key):
        if not Path(path).is_file():
            raise LinkError(f"{path}: no such file; the TLS options name PEM files")
    private, chain, authorities = _private_key(key), read_certificates(certificate), read_certificates(ca)
    own = chain[0]
    if private is not None and _public_bytes(private) != _public_bytes(own):
        raise LinkError(f"{key}: not the private key of {certificate}; {FIX}: both files belong together")
    check_time(certificate, own)
    if not _leads_to(chain, authorities):
        raise LinkError(
            f"{certificate}: issued by {name_of(own.issuer)!r}, and {ca} is {name_of(authorities[0].subject)!r}, which "
            f"has not signed it; {FIX}: both sides need certificates of the authority in --tls-ca"
        )
    _check_usage(certificate, own, listens=listens, connects=connects)


def check_time(path: str, certificate: "x509.Certificate") -> None:
    """Refuse a certificate that is not valid now.

    Raises:
        LinkError: it has ended, or is not valid yet.

    """
    now = datetime.now(UTC)
    clock = f"the clock of this machine shows {time_text(now)}"
    if now > certificate.not_valid_after_utc:
        raise LinkError(
            f"{path}: this certificate ended at {time_text(certificate.not_valid_after_utc)}, and {clock}; issue a new "
            "one (`perfbound pki issue`), or fix the clock"
        )
    if now < certificate.not_valid_before_utc:
        raise LinkError(
            f"{path}: this certificate is valid from {time_text(certificate.not_valid_before_utc)} on, and {clock}; "
            "fix the clock, or issue a new one"
        )


def check_valid(path: str) -> None:
    """Refuse the file of a certificate that is not valid now.

    Raises:
        LinkError: it has ended, or is not valid yet, or is no certificate.

    """
    check_time(path, read_certificates(path)[0])


def check_role(path: str, *roles: Role) -> None:
    """Refuse a certificate that `perfbound pki` has issued for another role; others have none.

    Raises:
        LinkError: it has another role, or is no certificate.

    """
    certificate = read_certificates(path)[0]
    found = role_of(certificate)
    if found is not None and found not in roles:
        raise LinkError(
            f"{path}: this is the certificate of the {found} {name_of(certificate.subject)!r}; choose one of the "
            f"{roles[0]} (`perfbound pki issue NAME --{roles[0]}`)"
        )


def check_host(path: str, host: str) -> None:
    """Refuse a certificate that does not name the host at which its owner listens; one of all interfaces is not judged.

    Raises:
        LinkError: whoever connects to `host` would refuse it, or it is no certificate.

    """
    names = hosts_of(read_certificates(path)[0])
    if not names:
        raise LinkError(
            f"{path}: names no host, so nobody can connect to it; issue a certificate with a subject alternative name "
            "(`perfbound pki issue ... --host HOST`)"
        )
    address = _address(host)
    if address is not None and address.is_unspecified:
        return
    if not any(_names(name, host) for name in names):
        found = ", ".join(shortened(name, 100) for name in names[:5])
        raise LinkError(
            f"{path}: names {found}, not {host}, so whoever connects to {host} refuses it; listen at a host that it "
            f"names or at all interfaces (0.0.0.0), or issue a certificate with `--host {host}`"
        )


def common_name(path: str) -> str:
    """Return the common name of a certificate in a PEM file; empty if it has none.

    Raises:
        LinkError: the file cannot be read, or is no certificate.

    """
    return name_of(read_certificates(path)[0].subject)


def name_of(subject: "x509.Name") -> str:
    """Return the common name; empty if there is none."""
    from cryptography.x509.oid import NameOID  # noqa: PLC0415  (for links with certificates alone, as those below)

    found = subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return shortened(str(found[0].value), 200) if found else ""


def role_of(certificate: "x509.Certificate") -> Role | None:
    """Return the role of a certificate that `perfbound pki` has issued; None for others."""
    from cryptography.x509.oid import NameOID  # noqa: PLC0415

    units = {str(each.value) for each in certificate.subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)}
    return next((role for role in ROLES if f"{UNIT}{role}" in units), None)


def hosts_of(certificate: "x509.Certificate") -> list[str]:
    """Return the host names and addresses of a certificate."""
    from cryptography import x509  # noqa: PLC0415

    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, ValueError):
        return []
    return [*found.get_values_for_type(x509.DNSName), *map(str, found.get_values_for_type(x509.IPAddress))]


def read_certificates(path: str) -> list["x509.Certificate"]:
    """Return the certificates of a PEM file, at least one.

    Raises:
        LinkError: the file cannot be read, or is no certificate.

    """
    from cryptography import x509  # noqa: PLC0415
    from cryptography.exceptions import UnsupportedAlgorithm  # noqa: PLC0415

    try:
        found = x509.load_pem_x509_certificates(read_with_status(Path(path), MOST)[0])
        for each in found:  # loading reads no key: a damaged one shows when it is used
            with suppress(UnsupportedAlgorithm):
                each.public_key()
        return found
    except FileNotFoundError:
        raise LinkError(f"{path}: no such file; the TLS options name PEM files") from None
    except (OSError, ValueError):
        raise LinkError(f"{path}: not the PEM file of a certificate; {FIX}") from None


def time_text(moment: datetime) -> str:
    """Return a moment to the minute.

    >>> time_text(datetime(2026, 1, 2, 3, 4, tzinfo=UTC))
    '2026-01-02 03:04 UTC'
    """
    return f"{moment:%Y-%m-%d %H:%M} UTC"


def _private_key(path: str) -> "PrivateKeyTypes | None":
    """Return the private key in a file; None if it is one that cannot be judged here."""
    from cryptography.exceptions import UnsupportedAlgorithm  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

    try:
        data, status = read_with_status(Path(path), MOST)
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror}; {FIX}") from None
    if exposed(status):
        raise LinkError(f"{path}: others can read this private key; run `chmod 600` on it")
    try:
        return load_pem_private_key(data, None)
    except TypeError:
        raise LinkError(
            f"{path}: this private key is encrypted with a password, for which a link cannot ask; issue one without"
        ) from None
    except UnsupportedAlgorithm:
        return None
    except ValueError:
        raise LinkError(f"{path}: not the PEM file of a private key; {FIX}") from None


def _public_bytes(owner: "PrivateKeyTypes | x509.Certificate") -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat  # noqa: PLC0415

    return owner.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def _leads_to(chain: Sequence["x509.Certificate"], authorities: Sequence["x509.Certificate"]) -> bool:
    """Whether one of `authorities` has signed the first certificate, or one of the others that has."""
    current, others = chain[0], list(chain[1:])
    while not any(_has_signed(authority, current) for authority in authorities):
        issuer = next((each for each in others if _has_signed(each, current)), None)
        if issuer is None:
            return False
        others.remove(issuer)
        current = issuer
    return True


def _has_signed(issuer: "x509.Certificate", certificate: "x509.Certificate") -> bool:
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm  # noqa: PLC0415

    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, InvalidSignature):  # another name, or another key of that name
        return False
    except (TypeError, UnsupportedAlgorithm):
        return True  # a kind of signature that cannot be judged here
    return True


def _check_usage(path: str, certificate: "x509.Certificate", *, listens: bool, connects: bool) -> None:
    from cryptography import x509  # noqa: PLC0415
    from cryptography.x509.oid import ExtendedKeyUsageOID as Known  # noqa: PLC0415

    try:
        usages = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except (x509.ExtensionNotFound, ValueError):
        return  # for any use
    if connects and Known.CLIENT_AUTH not in usages:
        raise LinkError(
            f"{path}: not for a side that connects (no clientAuth in its extended key usage); issue a certificate with "
            "it (`perfbound pki issue`)"
        )
    if listens and Known.SERVER_AUTH not in usages:
        raise LinkError(
            f"{path}: not for a side that listens (no serverAuth in its extended key usage), as that of a worker; "
            "choose the certificate of an orchestrator or router"
        )


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _names(name: str, host: str) -> bool:
    """Whether a name of a certificate is that of a host, as RFC 6125 has it.

    >>> _names("::1", "0:0::1"), _names("*.example", "a.example"), _names("*.example", "a.b.example")
    (True, True, False)
    """
    if (address := _address(host)) is not None:
        return _address(name) == address
    first, _, rest = host.lower().rstrip(".").partition(".")
    name = name.lower().rstrip(".")
    return name == f"{first}.{rest}".rstrip(".") or bool(rest and name == f"*.{rest}")
