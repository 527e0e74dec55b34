"""The reason why a link does not open, found by a TLS handshake: Zenoh reports every refusal as a timeout."""

import shlex
import socket
import ssl
from typing import TYPE_CHECKING

from ..errors import shortened
from .tls_files import common_name

if TYPE_CHECKING:
    from .configuration import Tls

PATIENCE = 1.0
"""Seconds for a connection, and for each step of the handshake."""
# The codes of X509_verify_cert in OpenSSL, of the other side's certificate.
_TIMES = {9: "is not valid yet", 10: "has ended"}
_AUTHORITY = {2, 18, 19, 20, 21}
_HOST = {62, 64}
_PURPOSE = 26
# The alerts of RFC 8446, section 6.2, by which the other side refuses ours.
_REFUSALS = {
    "TLSV1_ALERT_UNKNOWN_CA": "its --tls-ca has not signed it; give both sides certificates of one authority",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "by the clock of that host it has ended or not begun; compare the clocks",
    "SSLV3_ALERT_UNSUPPORTED_CERTIFICATE": "it is not for a side that connects; issue one with clientAuth",
    "SSLV3_ALERT_CERTIFICATE_REVOKED": "it was revoked; issue a new one",
}


def refusal(host: str, port: int, tls: "Tls") -> str | None:
    """Return why one of the sides refuses the other's certificate, with the remedy; None if none does, so far."""
    place = f"{host}:{port}"
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # as in Zenoh, an authority need not be a root
        context.load_verify_locations(tls.ca)
        context.load_cert_chain(tls.certificate, tls.key, password="")
        with socket.create_connection((host, port), PATIENCE) as plain:
            try:
                link = context.wrap_socket(plain, server_hostname=host)
            except TimeoutError:
                return (
                    f"{place} takes connections and begins no TLS handshake within {PATIENCE:g} s; choose the tls/ "
                    "endpoint of a router or orchestrator, and fix its firewall if others flood this port"
                )
            # In TLS 1.3 the other side examines our certificate when the handshake has ended for us.
            with link:
                link.recv(1)
    except ssl.SSLCertVerificationError as error:
        return f"the certificate of {place} {_wrong_certificate(error, host, tls)}"
    except ssl.SSLError as error:
        return _refused_certificate(error, place, tls)
    except OSError:
        return None  # no connection, or nothing said about the certificate
    return None


def speaks_tls(host: str, port: int) -> bool:
    """Whether what listens there expects TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # nothing is sent to it
    try:
        with (
            socket.create_connection((host, port), PATIENCE) as plain,
            context.wrap_socket(plain, server_hostname=host),
        ):
            return True
    except OSError as error:
        return "ALERT" in (getattr(error, "reason", None) or "")


def _wrong_certificate(error: ssl.SSLCertVerificationError, host: str, tls: "Tls") -> str:
    """Return what is wrong with the certificate of the other side."""
    if error.verify_code in _AUTHORITY:
        return f"is not signed by {tls.ca}; give both sides certificates of one authority"
    if error.verify_code in _HOST:
        return (
            f"does not name {host}; connect to a host that it names, or issue it again with `perfbound pki issue "
            f"... --host {shlex.quote(host)}`"
        )
    if error.verify_code in _TIMES:
        return f"{_TIMES[error.verify_code]}, by the clock of this machine; issue a new one there, or fix the clock"
    if error.verify_code == _PURPOSE:
        return "is not for a side that listens (no serverAuth), as that of a worker; choose another one there"
    return f"is refused here ({shortened(error.verify_message, 100)}); fix it there"


def _refused_certificate(error: ssl.SSLError, place: str, tls: "Tls") -> str | None:
    reason = error.reason or ""
    if reason in ("WRONG_VERSION_NUMBER", "UNEXPECTED_EOF_WHILE_READING", "RECORD_LAYER_FAILURE"):
        return f"{place} does not speak TLS; connect to the tls/ endpoint of a router or orchestrator"
    if "ALERT" not in reason:
        return None
    remedy = _REFUSALS.get(reason, f"its answer is {reason.lower().replace('_', ' ')}; issue a new one")
    return f"{place} refuses {tls.certificate} ({common_name(tls.certificate)!r}): {remedy}"
