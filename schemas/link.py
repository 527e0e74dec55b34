"""The configuration of both sides of the Zenoh link, in one place so that they agree."""

import ipaddress
import json
import re
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .base import Model
from .errors import LinkError
from .messages import MAX_RESULT
from .outside import exposed
from .seal import link_password

LEASE_MS = 2000
"""Silence after which a peer loses its liveliness token."""
STUCK_MS = 500
"""Time for which the orchestrator waits for a peer that does not read, then it closes the link."""
LOCAL = "tcp/127.0.0.1:0"
"""Loopback, a free port."""
ENCRYPTED = ("tls", "quic")
USER = "perfbound"
"""The user of a link with a secret, in the words of Zenoh."""
_ENDPOINT = re.compile(r"(?P<protocol>tcp|tls|quic)/(?P<host>\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z._-]+):(?P<port>[0-9]{1,5})")


class Tls(Model):
    """Mutual TLS: both sides show a certificate signed by `ca`; paths of PEM files."""

    ca: str
    certificate: str
    key: str


def listen_config(
    endpoint: str,
    tls: Tls | None,
    *,
    insecure: bool,
    passwords: str | None = None,
    access: Mapping[str, Any] | None = None,
) -> str:
    """Return the Zenoh configuration of the orchestrator.

    `passwords` is a file with `password_line`: who does not know the secret is refused. `access` are the rules of
    `schemas.access`.

    Raises:
        LinkError: the endpoint is malformed, or open to others without TLS, or a TLS file is missing.

    """
    protocol, host = _checked_endpoint("--listen", endpoint, tls)
    if protocol not in ENCRYPTED and not is_loopback(host) and not insecure:
        raise LinkError(
            f"--listen {endpoint}: anyone who reaches this address could feed the campaign; "
            "use a tls/ endpoint with --tls-ca, --tls-certificate and --tls-key, or add --insecure"
        )
    names = ("listen_certificate", "listen_private_key")
    common = _common(tls, names, None if passwords is None else {"dictionary_file": passwords})
    block = {"block": {"wait_before_close": STUCK_MS * 1000}}
    common["transport"]["link"]["tx"]["queue"] = {"congestion_control": block}
    return json.dumps(
        {
            **common,
            **({} if access is None else {"access_control": access}),
            "mode": "peer",
            "listen": {"endpoints": [endpoint]},
            "adminspace": {"enabled": False},  # it shows every peer the addresses of all others
        }
    )


def connect_config(endpoint: str, tls: Tls | None, secret: bytes | None = None) -> str:
    """Return the Zenoh configuration of a worker.

    Raises:
        LinkError: the endpoint is malformed, or a TLS file is missing.

    """
    _checked_endpoint("--connect", endpoint, tls)
    retry = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}
    return json.dumps(
        {
            **_common(
                tls,
                ("connect_certificate", "connect_private_key"),
                None if secret is None else {"user": USER, "password": link_password(secret)},
            ),
            "mode": "client",
            "connect": {"endpoints": [endpoint], "timeout_ms": 1000, "exit_on_failure": True, "retry": retry},
        }
    )


def password_line(secret: bytes) -> str:
    """Return the content of Zenoh's file of passwords."""
    return f"{USER}:{link_password(secret)}\n"


def split(endpoint: str) -> tuple[str, str]:
    """Return protocol and host of an endpoint such as `tcp/127.0.0.1:7447`.

    Raises:
        LinkError: it is not of that form.

    """
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None or int(found["port"]) > 65535:
        raise LinkError(
            f"{endpoint!r} is not an endpoint: write tcp/HOST:PORT, tls/HOST:PORT or quic/HOST:PORT, "
            "PORT at most 65535, an IPv6 HOST in brackets"
        )
    return found["protocol"], found["host"].strip("[]")


def with_port(endpoint: str) -> str:
    """Return a checked endpoint with a port that is free now, if it names port 0.

    Raises:
        LinkError: the host is no address of this machine.

    """
    protocol, host = split(endpoint)
    place = endpoint.rpartition(":")[0]
    if int(endpoint.removeprefix(f"{place}:")) != 0:
        return endpoint
    kind = socket.SOCK_DGRAM if protocol == "quic" else socket.SOCK_STREAM
    try:
        family, _, _, _, address = socket.getaddrinfo(host, 0, type=kind)[0]
        with socket.socket(family, kind) as chooser:
            chooser.bind(address)
            return f"{place}:{chooser.getsockname()[1]}"
    except OSError as error:
        raise LinkError(
            f"--listen {endpoint}: cannot listen there ({error.strerror}); choose an address of this machine"
        ) from None


def reachable(endpoint: str) -> str:
    """Return an endpoint that workers can connect to: that of all interfaces has the address of this machine."""
    _, host = split(endpoint)
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return endpoint
    if not address.is_unspecified:
        return endpoint
    family, elsewhere = (socket.AF_INET, "192.0.2.1") if address.version == 4 else (socket.AF_INET6, "2001:db8::1")
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((elsewhere, 9))  # sends nothing: the kernel names the interface that it would take
            own = str(probe.getsockname()[0])
        except OSError:  # no network but the loopback
            own = "127.0.0.1" if address.version == 4 else "::1"
    return endpoint.replace(host, own, 1)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def asks_for_secret(endpoint: str) -> bool:
    """Whether other users of this machine could reach `endpoint`, and need no certificate for it."""
    found = _ENDPOINT.fullmatch(endpoint)
    return found is not None and found["protocol"] not in ENCRYPTED and is_loopback(found["host"].strip("[]"))


def _checked_endpoint(option: str, endpoint: str, tls: Tls | None) -> tuple[str, str]:
    try:
        protocol, host = split(endpoint)
    except LinkError as error:
        raise LinkError(f"{option} {error}") from None
    if protocol in ENCRYPTED and tls is None:
        raise LinkError(f"{option} {endpoint}: {protocol} needs --tls-ca, --tls-certificate and --tls-key")
    if protocol not in ENCRYPTED and tls is not None:
        raise LinkError(f"{option} {endpoint}: {protocol} does not encrypt; with the TLS options write tls/HOST:PORT")
    return protocol, host


def _common(tls: Tls | None, names: tuple[str, str], user: Mapping[str, str] | None) -> dict[str, Any]:
    link: dict[str, Any] = {
        "tx": {"lease": LEASE_MS, "keep_alive": 4},
        "rx": {"max_message_size": MAX_RESULT + 1024 * 1024},
    }
    if tls is not None:
        for path in (tls.ca, tls.certificate, tls.key):
            if not Path(path).is_file():
                raise LinkError(f"{path}: no such file; the TLS options name PEM files")
        if exposed(Path(tls.key).stat()):
            raise LinkError(f"{tls.key}: others can read this private key; run `chmod 600` on it")
        link["tls"] = {
            "root_ca_certificate": tls.ca,
            names[0]: tls.certificate,
            names[1]: tls.key,
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
    authentication = {} if user is None else {"auth": {"usrpwd": dict(user)}}
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        # Shared memory is on by default and leaves 35 MB in /dev/shm after every run.
        "transport": {"shared_memory": {"enabled": False}, "link": link, **authentication},
    }
