"""A private certificate authority for the links of a fleet: X.509 certificates with keys on the curve P-256.

Every certificate of it is for one role. That of a worker can connect alone; those of orchestrators and routers can
listen as well, and name the hosts at which they do.
"""

import ipaddress
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ...schemas.errors import AuthorityError
from ...schemas.link.access import LOCAL
from ...schemas.link.tls_files import UNIT, Role, time_text

EARLY = timedelta(hours=1)
"""By which a certificate begins before it is issued: clocks of other hosts may be behind."""
_LABEL = r"[a-z0-9](?:[a-z0-9-]{0,61}[a-z0-9])?"
HOST = re.compile(rf"{_LABEL}(?:\.{_LABEL})*")
LONGEST_NAME = 64
"""Characters of a common name (X.520), and of a worker's name."""
LONGEST_HOST = 253


@dataclass(frozen=True, slots=True)
class Signer:
    """The authority: its certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


@dataclass(frozen=True, slots=True)
class Order:
    """What a certificate is issued for."""

    name: str
    role: Role
    hosts: tuple[str, ...] = ()
    """At which its owner listens."""


def new_authority(now: datetime, days: int) -> Signer:
    """Make an authority, with a random name, that signs certificates of its own alone, and no further authority."""
    # P-256: the TLS library of Zenoh takes it as well as Ed25519, and so does every other tool.
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"perfbound authority {secrets.token_hex(4)}")])
    signs = x509.KeyUsage(
        digital_signature=False, content_commitment=False, key_encipherment=False, data_encipherment=False,
        key_agreement=False, key_cert_sign=True, crl_sign=True, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    builder = (
        _valid(now, days)
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(signs, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return Signer(builder.sign(key, hashes.SHA256()), key)


def issue_certificate(
    signer: Signer, order: Order, now: datetime, days: int
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Issue a certificate for a checked order, with a key of its own.

    Raises:
        AuthorityError: the authority would end before it.

    """
    # Links do not check the end of the authority itself, so nothing that it issues may outlive it.
    left = (signer.certificate.not_valid_after_utc - now) // timedelta(days=1)
    if days > left:
        end = time_text(signer.certificate.not_valid_after_utc)
        remedy = f"choose --days {left} or less, or make" if left > 0 else "make"
        raise AuthorityError(
            f"--days {days}: the authority itself ends at {end}; {remedy} a new one with `perfbound pki init --folder`"
        )
    key = ec.generate_private_key(ec.SECP256R1())
    # The role is for people and clear refusals; what guards are the router's rules, which see common names alone.
    subject = [(NameOID.ORGANIZATIONAL_UNIT_NAME, f"{UNIT}{order.role}"), (NameOID.COMMON_NAME, order.name)]
    # Without serverAuth nobody can listen with the certificate of a worker.
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH] + ([ExtendedKeyUsageOID.SERVER_AUTH] if order.role != "worker" else [])
    signs = x509.KeyUsage(
        digital_signature=True, content_commitment=False, key_encipherment=False, data_encipherment=False,
        key_agreement=False, key_cert_sign=False, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    builder = (
        _valid(now, days)
        .subject_name(x509.Name([x509.NameAttribute(kind, text) for kind, text in subject]))
        .issuer_name(signer.certificate.subject)
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(signs, critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.certificate.public_key()),  # type: ignore[arg-type]
            critical=False,
        )
    )
    if order.hosts:
        names = x509.SubjectAlternativeName([_host_name(host) for host in order.hosts])
        builder = builder.add_extension(names, critical=False)
    return builder.sign(signer.key, hashes.SHA256()), key


def checked_order(name: str, role: Role, hosts: Sequence[str]) -> Order:
    """Return the order of a certificate; without hosts, one that listens is at the host of its name.

    Raises:
        AuthorityError: the name or a host cannot be used.

    """
    # No dot in the name of a worker, since it is a part of the keys of its messages, which have none.
    if len(name) > LONGEST_NAME or not HOST.fullmatch(name) or (role == "worker" and "." in name):
        dots = "" if role == "worker" else ", with dots between parts"
        raise AuthorityError(
            f"{name[:80]!r}: no name of a {role}; choose one of 1 to {63 if role == 'worker' else LONGEST_NAME} "
            f"characters: lower-case letters, digits and '-' inside{dots}"
        )
    if name == LOCAL or name.startswith(f"{LOCAL}-"):
        raise AuthorityError(f"{name!r}: a name of the local workers of an orchestrator; choose another name")
    if role == "worker":
        if hosts:
            raise AuthorityError("--host: a worker connects and does not listen; leave --host out")
        return Order(name, role)
    return Order(name, role, tuple(dict.fromkeys(map(_checked_host, hosts or [name]))))


def check_apart(order: Order, others: Sequence[Order], ended: Sequence[Order] = ()) -> None:
    """Refuse a name that another role has, or that `--allow` could not tell from that of another worker.

    A name keeps its role when its certificates have `ended`: a router may still list it in that role.

    Raises:
        AuthorityError: it is such a name.

    """
    for other in (*others, *ended):
        if other.name == order.name and other.role != order.role:
            raise AuthorityError(f"{order.name!r}: is the name of an issued {other.role}; choose another name")
    for other in others:
        # The rules of the link admit NAME-*: one of two such workers could speak for the other.
        both_workers = order.role == other.role == "worker"
        if both_workers and (other.name.startswith(f"{order.name}-") or order.name.startswith(f"{other.name}-")):
            raise AuthorityError(
                f"{order.name!r}: is not apart from the issued worker {other.name!r}, since one begins with the other "
                "and '-'; choose another name, such as with equally long numbers"
            )


def certificate_bytes(certificate: x509.Certificate) -> bytes:
    """Return a certificate as PEM."""
    return certificate.public_bytes(Encoding.PEM)


def key_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key as PEM, not encrypted: a link cannot ask for a password."""
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _valid(now: datetime, days: int) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLY)
        .not_valid_after(now + timedelta(days=days))
    )


def _checked_host(host: str) -> str:
    try:
        address = ipaddress.ip_address(host.removeprefix("[").removesuffix("]"))
    except ValueError:
        name = host.lower()
        # The last part of a host name is not a number: such a text is a mistyped address.
        if len(name) <= LONGEST_HOST and HOST.fullmatch(name) and not name.rpartition(".")[2].isdigit():
            return name
    else:
        if not address.is_unspecified and getattr(address, "scope_id", None) is None:
            return str(address)
    raise AuthorityError(f"--host {host[:80]!r}: no name or address of a host; write router.example or 10.0.0.1")


def _host_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
