"""The server of a live page: uvicorn, kept short."""

import asyncio
import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from ...run.address import Address
from ..collect import Collector
from .app import application
from .hosts import Hosts
from .snapshots import SnapshotCache

MOST_CONNECTIONS = 128
UNASKED = 10.0
"""Seconds for which a client may be connected before its first request is complete."""
LAST_WORDS = 5
"""Seconds in which the clients may take the end of the page."""


def server(directory: Path, address: Address, say: Callable[[str], None]) -> "Server":
    """Return the server of the page of the campaign in `directory`; `say` takes what goes wrong, in one line."""
    looks = SnapshotCache(Collector(directory), say)
    return Server(application(directory, looks, Hosts.of(address)), looks)


class Server(uvicorn.Server):
    """A server whose clients are shown the end."""

    def __init__(self, application: ASGIApp, looks: SnapshotCache) -> None:
        self.looks = looks
        super().__init__(
            uvicorn.Config(
                application,
                http=_Impatient,
                loop="asyncio",
                ws="none",
                lifespan="off",
                interface="asgi3",
                log_config=None,
                log_level="critical",  # what goes wrong is said by us, in one line
                access_log=False,
                server_header=False,
                proxy_headers=False,
                limit_concurrency=MOST_CONNECTIONS,
                timeout_graceful_shutdown=LAST_WORDS,
            )
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Give the port back first, then let the clients take a last look."""
        for server in self.servers:
            server.close()
        self.looks.close()
        await super().shutdown(sockets)


class _Impatient(H11Protocol):
    """Drops a client that connects and asks nothing: it would keep others out."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.loop.call_later(UNASKED, self._unasked)

    def _unasked(self) -> None:
        if self.cycle is None:
            self.transport.abort()
