"""The configuration of the ends of the Zenoh link and of the routers between, in one place so that they agree."""

import ipaddress
import itertools
import json
import re
import socket
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from ..base import Model
from ..errors import LinkError
from .messages import MAX_RESULT
from .seal import link_password
from .tls_files import Role, check_host, check_link_files, check_role

LEASE_MS = 2000
"""Silence after which a peer loses its liveliness token."""
STUCK_MS = 500
"""Time for which the orchestrator waits for a peer that does not read, then it closes the link."""
LOCAL = "tcp/127.0.0.1:0"
"""Loopback, a free port."""
ENCRYPTED = ("tls", "quic")
RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}
MOST_LINKS = 10_000
"""Links that a node accepts, of Zenoh's own default of 1,000; as many as an orchestrator takes workers."""
Side = Literal["listen", "connect"]
"""Of a link, in the words of Zenoh."""
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
    """Return the Zenoh configuration of an orchestrator that workers connect to.

    `passwords` is a file with `password_line`: who does not know the secret is refused. `access` are the rules of
    `schemas.link.access`.

    Raises:
        LinkError: the endpoint is malformed, or open to others without TLS, or a TLS file cannot be used.

    """
    _check_accepting(endpoint, tls, insecure=insecure)
    user = None if passwords is None else {"dictionary_file": passwords}
    node = _accepting(tls, ("listen",), user, access)
    _check_hosts([endpoint], tls)
    return json.dumps({**node, "mode": "peer", "listen": {"endpoints": [endpoint]}})


def connect_config(endpoints: Sequence[str], tls: Tls | None, secret: bytes | None = None) -> str:
    """Return the Zenoh configuration of a worker, or of an orchestrator behind a router.

    Of several endpoints one is used at a time; when its link ends, the next one is tried.

    Raises:
        LinkError: an endpoint is malformed, or a TLS file cannot be used.

    """
    for endpoint in endpoints:
        checked_endpoint("--connect", endpoint, tls)
    return json.dumps(
        {
            **_common(tls, ("connect",), None if secret is None else _user(secret)),
            "mode": "client",
            "connect": {"endpoints": list(endpoints), "timeout_ms": 1000, "exit_on_failure": True, "retry": RETRY},
        }
    )


def connect_configs(endpoints: Sequence[str], tls: Tls | None, secret: bytes | None = None) -> Iterator[str]:
    """Return configurations to try in turn, without end: Zenoh opens a session only by way of the first endpoint.

    Once a session is open it finds the others by itself.

    Raises:
        LinkError: an endpoint is malformed, or a TLS file is missing.

    """
    ways = [(*endpoints[first:], *endpoints[:first]) for first in range(len(endpoints))]
    return itertools.cycle([connect_config(way, tls, secret) for way in ways])


def router_config(
    endpoints: Sequence[str],
    routers: Sequence[str],
    tls: Tls | None,
    *,
    insecure: bool,
    secret: bytes | None = None,
    passwords: str | None = None,
    access: Mapping[str, Any] | None = None,
) -> str:
    """Return the Zenoh configuration of a router that listens at `endpoints` and links itself with other `routers`.

    Raises:
        LinkError: an endpoint is malformed, or open to others without TLS, or a TLS file cannot be used.

    """
    for endpoint in endpoints:
        _check_accepting(endpoint, tls, insecure=insecure)
    for endpoint in routers:
        checked_endpoint("--connect", endpoint, tls)
    user = None if passwords is None or secret is None else {**_user(secret), "dictionary_file": passwords}
    node = _accepting(tls, ("listen", "connect") if routers else ("listen",), user, access)
    _check_hosts(endpoints, tls)
    return json.dumps(
        {
            **node,
            "mode": "router",
            "listen": {"endpoints": list(endpoints)},
            # It serves its own links while another router is away, and tries again for as long as it runs.
            "connect": {"endpoints": list(routers), "timeout_ms": 0, "exit_on_failure": False, "retry": RETRY},
        }
    )


def _user(secret: bytes) -> dict[str, str]:
    return {"user": USER, "password": link_password(secret)}


def password_line(secret: bytes) -> str:
    """Return the content of Zenoh's file of passwords."""
    return f"{USER}:{link_password(secret)}\n"


def check_own(option: str, endpoints: Sequence[str], tls: Tls, role: Role) -> None:
    """Check that the endpoints of a side fit its TLS options, and that its certificate is for its role.

    Raises:
        LinkError: they do not, or it is for another one.

    """
    for endpoint in endpoints:
        checked_endpoint(option, endpoint, tls)
    check_role(tls.certificate, role)


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
            # The kernel chooses, and the port is free again at the end of the block: another process may be faster.
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


def checked_endpoint(option: str, endpoint: str, tls: Tls | None) -> tuple[str, str]:
    """Return protocol and host of an endpoint that fits the TLS options.

    Raises:
        LinkError: it is malformed, or encrypted without these options, or the other way round.

    """
    try:
        protocol, host = split(endpoint)
    except LinkError as error:
        raise LinkError(f"{option} {error}") from None
    if protocol in ENCRYPTED and tls is None:
        raise LinkError(f"{option} {endpoint}: {protocol} needs --tls-ca, --tls-certificate and --tls-key")
    if protocol not in ENCRYPTED and tls is not None:
        raise LinkError(f"{option} {endpoint}: {protocol} does not encrypt; with the TLS options write tls/HOST:PORT")
    return protocol, host


def _check_accepting(endpoint: str, tls: Tls | None, *, insecure: bool) -> None:
    protocol, host = checked_endpoint("--listen", endpoint, tls)
    if protocol not in ENCRYPTED and not is_loopback(host) and not insecure:
        raise LinkError(
            f"--listen {endpoint}: anyone who reaches this address could feed the campaign; "
            "use a tls/ endpoint with --tls-ca, --tls-certificate and --tls-key, or add --insecure"
        )


def _check_hosts(endpoints: Sequence[str], tls: Tls | None) -> None:
    """Refuse to listen where every side that connects would refuse the certificate."""
    for endpoint in endpoints:
        protocol, host = split(endpoint)
        if protocol in ENCRYPTED and tls is not None:
            check_host(tls.certificate, host)


def _accepting(
    tls: Tls | None, sides: Sequence[Side], user: Mapping[str, str] | None, access: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return what a node that others connect to has beyond its mode and its endpoints."""
    common = _common(tls, sides, user)
    # A peer that does not read must not hold up the messages to all others.
    block = {"block": {"wait_before_close": STUCK_MS * 1000}}
    common["transport"]["link"]["tx"]["queue"] = {"congestion_control": block}
    common["transport"]["unicast"] = {"max_sessions": MOST_LINKS}
    rules = {} if access is None else {"access_control": access}
    # The admin space would show every peer the addresses of all others.
    return {**common, **rules, "adminspace": {"enabled": False}}


def _common(tls: Tls | None, sides: Sequence[Side], user: Mapping[str, str] | None) -> dict[str, Any]:
    link: dict[str, Any] = {
        "tx": {"lease": LEASE_MS, "keep_alive": 4},
        "rx": {"max_message_size": MAX_RESULT + 1024 * 1024},
    }
    if tls is not None:
        check_link_files(tls.ca, tls.certificate, tls.key, listens="listen" in sides, connects="connect" in sides)
        link["tls"] = {
            "root_ca_certificate": tls.ca,
            **{f"{side}_certificate": tls.certificate for side in sides},
            **{f"{side}_private_key": tls.key for side in sides},
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
    authentication = {} if user is None else {"auth": {"usrpwd": dict(user)}}
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        # Shared memory is on by default and leaves 35 MB in /dev/shm after every run.
        "transport": {"shared_memory": {"enabled": False}, "link": link, **authentication},
    }
