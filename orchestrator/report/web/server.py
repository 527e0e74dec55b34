"""The uvicorn server of a live page: its configuration, its limits on connections, its shutdown."""

import asyncio
import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from ...run.address import Address
from ..collect import Collector
from .app import application
from .snapshots import SnapshotCache

MOST_CONNECTIONS = 128
FIRST_REQUEST = 10.0
"""Seconds in which a client must complete its first request."""
SHUTDOWN = 1
"""Seconds in which clients may read the last snapshot."""


class Server(uvicorn.Server):
    """The server of the page of the campaign in `directory`; clients get a last snapshot at shutdown.

    `report` takes every error as one line.
    """

    def __init__(self, directory: Path, address: Address, report: Callable[[str], None]) -> None:
        self.snapshots = SnapshotCache(Collector(directory), report)
        super().__init__(
            uvicorn.Config(
                application(directory, self.snapshots, address),
                http=_ImpatientProtocol,
                loop="asyncio",
                ws="none",
                lifespan="off",
                interface="asgi3",
                log_config=None,
                log_level="critical",  # errors are reported by the application, in one line
                access_log=False,
                server_header=False,
                proxy_headers=False,
                limit_concurrency=MOST_CONNECTIONS,
                timeout_graceful_shutdown=SHUTDOWN,
            )
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Release the port, then let the streams send the last snapshot."""
        for server in self.servers:  # first: a resumed run may bind the same port while clients still read
            server.close()
        self.snapshots.closing.set()
        await super().shutdown(sockets)


class _ImpatientProtocol(H11Protocol):
    """HTTP that drops a connection without a request: idle ones would use up `MOST_CONNECTIONS`."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.loop.call_later(FIRST_REQUEST, self._drop_if_idle)

    def _drop_if_idle(self) -> None:
        if self.cycle is None:
            self.transport.abort()
