"""The place of a live page as it is asked for, and the token and the certificate that guard it."""

import ipaddress
import json
import re
import secrets
import socket
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ....schemas.errors import PerfboundError
from ....schemas.link.secret import WEB_VARIABLE
from ....schemas.link.tls_files import MOST, check_valid
from ....schemas.outside import exposed, read_with_status
from .address import Address, bind

_FORM = re.compile("[A-Za-z0-9._~-]{16,200}")
"""Characters that stand for themselves in an address and in a header."""
UNENCRYPTED = "the token of the live page travels unencrypted; --web-tls-certificate and --web-tls-key encrypt it"


@dataclass(frozen=True, slots=True)
class PageTls:
    """PEM files of the certificate of a live page, with those between it and its authority, and of its key."""

    certificate: str
    key: str


@dataclass(frozen=True, slots=True)
class PagePlace:
    """Where to serve a live page, and what the user asks for its protection."""

    address: Address = Address()  # noqa: RUF009  (frozen)
    tls: PageTls | None = None
    with_token: bool = False
    """Whether a token is asked for on loopback, too, where other users of this machine could read the page."""
    token: str | None = field(default=None, repr=False)
    """That of the environment."""


@dataclass(frozen=True, slots=True)
class PageAccess:
    """What a request of a live page must show, and how it is encrypted."""

    token: str | None = field(default=None, repr=False)
    chosen: bool = False
    """Whether the user chose the token, and knows it."""
    tls: PageTls | None = None
    beyond: bool = False
    """Whether other machines reach the page."""

    @property
    def scheme(self) -> str:
        """The scheme of its addresses."""
        return "http" if self.tls is None else "https"

    def lines(self, title: str, address: Address) -> Iterator[str]:
        """Yield what a user reads when the page begins: its address, with the token unless the user chose that."""
        url = address.url_with(self.scheme)
        if self.token is not None and self.chosen:
            yield f"{title}: {url} (asks for the token in {WEB_VARIABLE})"
        else:
            yield f"{title}: {url}{f'?token={self.token}' if self.token else ''}"
        if self.beyond and self.tls is None:
            yield UNENCRYPTED

    def to_json(self) -> bytes:
        """Return it as text for the process of the page."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, text: bytes) -> "PageAccess":
        """Read what `to_json` has written."""
        found = json.loads(text)
        return cls(**{**found, "tls": PageTls(**found["tls"]) if found["tls"] else None})


OPEN = PageAccess()
"""A page without a token, on loopback."""


def opened(place: PagePlace, *, insecure: bool) -> tuple[socket.socket, Address, PageAccess]:
    """Return a socket that listens at a place, its address, and the protection of the page there.

    Raises:
        PerfboundError: the token or the certificate cannot be used, or the address, see `bind`.

    """
    if place.token is not None and not _FORM.fullmatch(place.token):
        raise PerfboundError(
            f"{WEB_VARIABLE}: a token has 16 to 200 letters, digits, dots, hyphens, underscores or tildes; choose one "
            "with `openssl rand -hex 32`"
        )
    if place.tls is not None:
        _check_certificate(place.tls)
    listening, address = bind(place.address, insecure=insecure or place.tls is not None)
    beyond = not ipaddress.ip_address(listening.getsockname()[0].partition("%")[0]).is_loopback
    token = place.token
    if token is None and (beyond or place.with_token):
        token = secrets.token_urlsafe(32)
    return listening, address, PageAccess(token, place.token is not None, place.tls, beyond)


def _check_certificate(tls: PageTls) -> None:
    import ssl  # noqa: PLC0415  (late: most commands need none)

    for option, path in (("--web-tls-certificate", tls.certificate), ("--web-tls-key", tls.key)):
        try:
            _, status = read_with_status(Path(path), MOST)
        except OSError as error:
            raise PerfboundError(f"{option} {path}: {error.strerror}") from None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        # A password in place of the question for one, which nobody would answer: an encrypted key is refused.
        context.load_cert_chain(tls.certificate, tls.key, password="")
    except (ssl.SSLError, ValueError) as error:
        reason = getattr(error, "reason", None) or "unreadable"
        raise PerfboundError(
            f"--web-tls-certificate {tls.certificate}, --web-tls-key {tls.key}: no certificate with its unencrypted "
            f"key in PEM ({reason}); choose a pair that belongs together"
        ) from None
    if exposed(status):  # of the key, the last one
        raise PerfboundError(f"--web-tls-key {tls.key}: others can read this private key; run `chmod 600` on it")
    check_valid(tls.certificate)  # no browser would open the page, and no Prometheus read its metrics
