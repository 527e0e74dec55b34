"""The address of a live page: parsed, guarded, and bound before anything else is started."""

import errno
import ipaddress
import re
import socket
import time
from dataclasses import dataclass

from ....schemas.errors import PerfboundError
from ....schemas.host import host_name

BACKLOG = 64
"""Connections that may wait to be accepted."""
STALLED_MS = 30_000
"""The kernel drops a client that takes no data for this time: it is dead, asleep, or hostile."""
PATIENCE, PAUSE = 1.0, 0.05
"""Seconds that a port may still belong to the page of a killed orchestrator, and between two tries."""
_FORM = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z._-]+):)?(?P<port>[0-9]{1,5})")


@dataclass(frozen=True, slots=True)
class Address:
    """A host, by name or number, and a port; port 0 is a free one."""

    host: str = "127.0.0.1"
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> "Address":
        """Read `HOST:PORT`, or a port of the loopback.

        Raises:
            ValueError: it is neither.

        """
        found = _FORM.fullmatch(text)
        if found is None or int(found["port"]) > 65535:
            raise ValueError(f"{text!r} is not HOST:PORT, PORT at most 65535, an IPv6 HOST in brackets")
        return cls((found["host"] or cls().host).strip("[]"), int(found["port"]))

    @property
    def everywhere(self) -> bool:
        """Whether this means every address of the machine."""
        try:
            return ipaddress.ip_address(self.host).is_unspecified
        except ValueError:
            return False

    @property
    def url(self) -> str:
        """The address for a browser."""
        return self.url_with("http")

    def url_with(self, scheme: str) -> str:
        """Return the address for a browser, by `http` or `https`."""
        host = host_name() if self.everywhere else self.host
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    def __str__(self) -> str:
        return f"{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


def bind(address: Address, *, insecure: bool) -> tuple[socket.socket, Address]:
    """Return a socket that listens at `address`, and the address with its port.

    Raises:
        PerfboundError: the port is taken, the host is not of this machine, or is open to others and not `insecure`.

    """
    try:
        family, _, _, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
        host = str(place[0])
        if not ipaddress.ip_address(host.partition("%")[0]).is_loopback and not insecure:
            raise PerfboundError(
                f"--web {address}: anyone on the way to this address could read the campaign and the token of its "
                "page; add --web-tls-certificate and --web-tls-key, serve it at 127.0.0.1 (ssh -L reaches it, too), or "
                "add --insecure"
            )
        listening = _listening(family, host, address.port)
    except (OSError, UnicodeError) as error:  # UnicodeError: a name that cannot be one of a host
        raise PerfboundError(_bind_error(address, error)) from None
    # Inherited by every connection; it covers a client that does not read as well as one that is gone.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, STALLED_MS)
    return listening, Address(address.host, listening.getsockname()[1])


def _listening(family: int, host: str, port: int) -> socket.socket:
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return socket.create_server((host, port), family=family, backlog=BACKLOG)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or time.monotonic() > deadline:
                raise
        time.sleep(PAUSE)


def _bind_error(address: Address, error: Exception) -> str:
    if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
        return f"--web {address}: this port is in use; choose another, or 0 for a free one"
    reason = str(getattr(error, "strerror", None) or error).partition(" (while ")[0]
    return f"--web {address}: cannot listen there ({reason}); check the address"
