"""The uvicorn server of live pages: its configuration, its limits on connections, its shutdown."""

import asyncio
import errno
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from ...run.page.address import Address
from ...run.page.page_access import OPEN, PageAccess
from ..collect.campaign import Collector
from .app import application
from .campaign_index import CampaignIndex
from .index_app import index_application
from .index_cache import IndexCache
from .open_campaigns import OpenCampaigns
from .run_feed import RunFeed
from .security import HEADERS, HEALTH
from .snapshots import SnapshotCache

MOST_CONNECTIONS = 128
"""Clients with a request under way. Those without one make room for others from here on."""
COMPLETE_REQUEST = 10.0
"""Seconds in which a client must complete a request; at most twice as long behind another one."""
_TOO_MANY = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
SHUTDOWN = 1
"""Seconds in which clients may read the last snapshot."""


class PageServer(uvicorn.Server):
    """A server of pages; clients get a last snapshot at shutdown, when `close` is called."""

    def __init__(
        self, web_application: ASGIApp, close: Callable[[], None], access: PageAccess, report: Callable[[str], None]
    ) -> None:
        self._close, self._report, self._crowded = close, report, False
        tls = access.tls
        super().__init__(
            uvicorn.Config(
                _BusyLimit(web_application),
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
                backlog=MOST_CONNECTIONS,
                timeout_graceful_shutdown=SHUTDOWN,
                ssl_certfile=tls.certificate if tls else None,
                ssl_keyfile=tls.key if tls else None,
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve."""
        asyncio.get_running_loop().set_exception_handler(self._loop_fault)
        await super().startup(sockets)

    def _loop_fault(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        # asyncio reports this one, with a traceback, for every connection that it cannot take, again and again.
        if getattr(context.get("exception"), "errno", None) not in _TOO_MANY:
            loop.default_exception_handler(context)
        elif not self._crowded:
            self._crowded = True
            self._report("more connections than this process may open files; further ones have to wait")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Release the port, then let the streams send the last snapshot."""
        for server in self.servers:  # first: a resumed run may bind the same port while clients still read
            server.close()
        self._close()
        await super().shutdown(sockets)


class Server(PageServer):
    """The server of the page of the campaign in `directory`; `report` takes every error as one line.

    `feed` is that of the orchestrator whose page this is; None for a page beside it, or without one.
    """

    def __init__(
        self,
        directory: Path,
        address: Address,
        report: Callable[[str], None],
        access: PageAccess = OPEN,
        feed: RunFeed | None = None,
    ) -> None:
        self.snapshots = SnapshotCache(Collector(directory), report)
        self.feed = feed or RunFeed()
        web_application = application(directory, self.snapshots, address, access, feed)
        super().__init__(web_application, self.snapshots.closing.set, access, report)


class IndexServer(PageServer):
    """The server of the index of the campaigns below `folder`, and of their pages; `report` as for `Server`."""

    def __init__(
        self, folder: Path, address: Address, report: Callable[[str], None], access: PageAccess = OPEN
    ) -> None:
        campaigns = OpenCampaigns(report)
        self._index = IndexCache(CampaignIndex(folder, report), report)
        super().__init__(index_application(self._index, campaigns, address, access), campaigns.close, access, report)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve, and to read the campaigns at once: until a browser is there, many have been read."""
        await super().startup(sockets)
        self._index.begin()


class _BusyLimit:
    """An application with `MOST_CONNECTIONS` requests under way at most; the probe of its life is always answered.

    The server itself would count connections, also idle ones, and refuse the probe too: a client with enough of them
    could have the run restarted.
    """

    def __init__(self, inner: ASGIApp) -> None:
        self._inner, self._under_way = inner, 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == HEALTH:
            await self._inner(scope, receive, send)
            return
        if self._under_way >= MOST_CONNECTIONS:
            refusal = PlainTextResponse(f"{MOST_CONNECTIONS} requests are under way; try again later\n", 503, HEADERS)
            await refusal(scope, receive, send)
            return
        self._under_way += 1
        try:
            await self._inner(scope, receive, send)
        finally:
            self._under_way -= 1


class _ImpatientProtocol(H11Protocol):
    """HTTP that drops a connection on which no request is completed, early if there are many.

    A response under way may take its time.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._since = self.loop.time()
        if len(self.connections) > MOST_CONNECTIONS:
            self._make_room()
        self._check_later()

    def _make_room(self) -> None:
        """Drop the connection that has been without a request for longest; without any, and with too many, this one."""
        others = (each for each in self.connections if each is not self and isinstance(each, _ImpatientProtocol))
        idle = [each for each in others if each.is_idle and not each.transport.is_closing()]
        if idle:
            min(idle, key=lambda each: each._since).transport.abort()
        elif len(self.connections) > 2 * MOST_CONNECTIONS:
            self.transport.abort()  # up to there a client gets the reason; files stay free for the database

    @property
    def is_idle(self) -> bool:
        """Whether no response is under way."""
        return _answered(self.cycle)

    def _check_later(self) -> None:
        self.loop.call_later(COMPLETE_REQUEST, self._drop_if_idle, self.cycle)

    def _drop_if_idle(self, before: RequestResponseCycle | None) -> None:
        if self.transport.is_closing():
            return
        # For the first request, for a further one, or for the body of an answered one uvicorn waits without a limit.
        if _answered(before) and self.cycle is before:
            self.transport.abort()
        else:
            self._check_later()


def _answered(cycle: RequestResponseCycle | None) -> bool:
    """Whether there is no request, or its response is complete."""
    return cycle is None or cycle.response_complete
