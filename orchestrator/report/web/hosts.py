"""What every request passes: who may ask, how much, and what a browser is told about the answer.

A page on this machine is in reach of every web site that its owner opens: a site whose name is made to lead here
(DNS rebinding) reads what a server sends that answers to any name. So this one answers to its own names only.
"""

import ipaddress
import os
import re
from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...run.address import Address

LONGEST = 1000
"""Bytes of a path with its query."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer that does not say otherwise."""
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[0-9a-z._-]+)(?::[0-9]{1,5})?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Hosts:
    """The names that we answer to."""

    names: frozenset[str]
    numbers: bool
    """Whether every number is ours, too: nobody can make a number lead elsewhere."""

    @classmethod
    def of(cls, address: Address) -> "Hosts":
        """Return those of a page at `address`."""
        here = {os.uname().nodename.lower()} if address.everywhere else set()
        return cls(frozenset({"localhost", "127.0.0.1", "::1", address.host.lower(), *here}), address.everywhere)

    def allow(self, header: str) -> bool:
        """Whether a Host header names us.

        >>> Hosts.of(Address("127.0.0.1", 80)).allow("localhost:80"), Hosts.of(Address()).allow("evil.example:80")
        (True, False)
        """
        found = _HOST.fullmatch(header)
        host = found[1].strip("[]").lower() if found else ""
        return host in self.names or (self.numbers and _is_number(host))


class Guard:
    """Stands before an application."""

    def __init__(self, inner: ASGIApp, hosts: Hosts) -> None:
        self._inner, self._hosts = inner, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or pass it on."""

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await (self._refusal(scope) or self._inner)(scope, receive, guarded)

    def _refusal(self, scope: Scope) -> ASGIApp | None:
        hosts = Headers(scope=scope).getlist("host")
        if len(hosts) != 1:
            return PlainTextResponse("a request names one host", 400)
        if not self._hosts.allow(hosts[0]):
            return PlainTextResponse("this page is not of the host that was asked for; use the URL it was given", 421)
        if len(scope["raw_path"]) + len(scope["query_string"]) > LONGEST:
            return PlainTextResponse(f"an address here has at most {LONGEST} bytes", 414)
        return None


def _is_number(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
