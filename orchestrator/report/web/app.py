"""The live page as a web application: read-only, restricted to the configured host names.

| route                  | response                                                             |
|------------------------|----------------------------------------------------------------------|
| `/`                    | the page with the current data                                       |
| `/events`              | the data again after every change, as server-sent events             |
| `/story.json`          | the current data                                                     |
| `/scene`               | `?problem=NAME&test=N`: the rollouts of one test, as curves          |
| `/trajectories/...`    | the file of a recorded rollout                                       |
| `/certificate.json`    | the certificate, once there is one                                   |
| `/counterexamples.csv` | the rollouts with robustness below 0                                 |
| `/metrics`             | the numbers of the campaign, for Prometheus                          |
| `/healthz`, `/readyz`  | whether the page and its run live, and whether they are ready        |
"""

import io
import re
import stat
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from anyio import CapacityLimiter, to_thread
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from ....schemas.errors import EvidenceError, PerfboundError, one_line
from ...certificate.files import CERTIFICATE, MAX_CERTIFICATE
from ...run.page.address import Address
from ...run.page.page_access import OPEN, PageAccess
from ...store import export, files
from ...store.changes import rollouts_of
from ...store.files import FOLDER
from .. import html as document
from .metrics import CampaignMetrics
from .run_feed import RunFeed
from .security import restricted
from .snapshots import SnapshotCache
from .watching import watching_routes

MOST_STREAMS = 32
MOST_FILES = 4
"""Files read at the same time."""
KEEP_ALIVE = 15.0
"""Seconds without a change after which a stream sends a comment, so that proxies keep it open."""
FIRST_PICTURE = 1.0
"""Seconds in which a page is there, with the data or without."""
RETRY, COMMENT = b"retry: 1000\n\n", b": still here\n\n"
JSON, EVENTS = "application/json", "text/event-stream"
_NUMBER = re.compile("[0-9]{1,9}")


@dataclass(slots=True)
class ServerLimits:
    """What is open on one server, whether it has one campaign or many."""

    streams: Counter[Path] = field(default_factory=Counter)
    """Open event streams by run directory."""
    files: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(MOST_FILES))


def application(
    directory: Path, snapshots: SnapshotCache, address: Address, access: PageAccess = OPEN, feed: RunFeed | None = None
) -> ASGIApp:
    """Return the application for the campaign in `directory`, served at `address`."""
    return restricted(campaign_application(directory, snapshots, ServerLimits(), feed=feed), address, access)


def campaign_application(
    directory: Path, snapshots: SnapshotCache, limits: ServerLimits, index: str = "", feed: RunFeed | None = None
) -> Starlette:
    """Return the application without the checks of a request; `index` is the relative address of an index above it.

    `feed` is that of the orchestrator whose page this is.
    """
    web = _Endpoints(directory, snapshots, limits, index)
    routes = [
        Route("/", web.page),
        Route("/events", web.events),
        Route("/story.json", web.data),
        Route("/scene", web.rollouts_of_test),
        Route(f"/{FOLDER}/{{rest:path}}", web.trajectory),
        Route(f"/{CERTIFICATE}", web.certificate),
        Route("/counterexamples.csv", web.counterexamples),
        *watching_routes(CampaignMetrics(directory, feed), feed),
    ]
    return Starlette(routes=routes, exception_handlers={PerfboundError: _unreadable, 500: web.internal_error})


class _Endpoints:
    """The responses of the routes."""

    def __init__(self, directory: Path, snapshots: SnapshotCache, limits: ServerLimits, index: str) -> None:
        self._directory, self._snapshots, self._limits, self._index = directory, snapshots, limits, index

    async def page(self, _: Request) -> Response:
        # A long campaign takes seconds to read for the first time: the page says so, and its events bring the data.
        snapshot = await self._snapshots.soon(FIRST_PICTURE)
        title, data = (self._directory.name, "") if snapshot is None else (snapshot.title, snapshot.json)
        html, policy = document.served_page(title, data, self._index)
        return HTMLResponse(html, headers={"Content-Security-Policy": f"{policy}; frame-ancestors 'none'"})

    async def data(self, _: Request) -> Response:
        return Response((await self._snapshots.available()).json, media_type=JSON)

    async def rollouts_of_test(self, request: Request) -> Response:
        problem, test = request.query_params.get("problem", ""), request.query_params.get("test", "")
        if not _NUMBER.fullmatch(test):
            return plain("/scene: wrong query; use /scene?problem=NAME&test=NUMBER", 400)
        try:
            return Response(await self._snapshots.rollouts_of_test(problem, int(test)), media_type=JSON)
        except PerfboundError as error:
            return plain(str(error), 404)

    async def trajectory(self, request: Request) -> Response:
        path = f"{FOLDER}/{request.path_params['rest']}"
        return await self._file(partial(recorded_file, self._directory, path), "application/octet-stream")

    async def certificate(self, _: Request) -> Response:
        return await self._file(partial(certificate, self._directory, CERTIFICATE), JSON)

    async def counterexamples(self, _: Request) -> Response:
        return await self._file(self._counterexamples, "text/csv")

    def _counterexamples(self) -> bytes:
        out = io.BytesIO()
        export.stream(self._directory, "counterexamples", out)
        return out.getvalue()

    async def _file(self, read: Callable[[], bytes | None], media_type: str) -> Response:
        try:
            data = await to_thread.run_sync(read, limiter=self._limits.files)
        except EvidenceError as error:
            return plain(str(error), 404)
        if data is None:
            return plain("there is no such file, or not yet", 404)
        # An attachment: a browser must not display what a worker wrote.
        return Response(data, media_type=media_type, headers={"Content-Disposition": "attachment"})

    async def internal_error(self, request: Request, error: Exception) -> Response:
        self._snapshots.report(f"{request.url.path}: {error!r}")
        return plain("internal error; see the output of perfbound", 500)

    async def events(self, request: Request) -> Response:
        if self._limits.streams.total() >= MOST_STREAMS:
            return plain(f"{MOST_STREAMS} pages are open; close one and reload this one", 503)
        if request.method == "HEAD":  # its stream would have no end
            return Response(media_type=EVENTS)
        self._limits.streams[self._directory] += 1
        return _CountedStream(self._stream(), self._stream_ended)

    def _stream_ended(self) -> None:
        self._limits.streams[self._directory] -= 1

    async def _stream(self) -> AsyncIterator[bytes]:
        """Yield the data after every change, and at the end; a slow client skips intermediate snapshots.

        As long as the campaign was never readable, yield why.
        """
        sent, reported, sent_at = -1, "", time.monotonic()
        yield RETRY
        while True:
            last = self._snapshots.closing.is_set()
            snapshot = await self._snapshots.latest()
            if snapshot is not None and snapshot.number != sent:
                sent, sent_at = snapshot.number, time.monotonic()
                yield f"event: story\nid: {sent}\ndata: {snapshot.json}\n\n".encode()
            elif snapshot is None and self._snapshots.error != reported:
                reported, sent_at = self._snapshots.error, time.monotonic()
                yield f"event: fault\ndata: {one_line(reported)}\n\n".encode()
            elif time.monotonic() - sent_at >= KEEP_ALIVE:
                sent_at = time.monotonic()
                yield COMMENT
            if last:
                return
            await self._snapshots.pause(KEEP_ALIVE)


class _CountedStream(StreamingResponse):
    """A stream that reports its end, also after an error or a lost connection."""

    def __init__(self, content: AsyncIterator[bytes], ended: Callable[[], None]) -> None:
        super().__init__(content, media_type=EVENTS)
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._ended()


def plain(text: str, status: int) -> Response:
    """Return one line of text."""
    return PlainTextResponse(one_line(text) + "\n", status)


def _unreadable(_: Request, error: Exception) -> Response:
    return plain(str(error), 503)


# Files of a run directory. A path from a request is never opened: it is looked up in the database, and its file must be
# in the run directory, reached without a symbolic link, and have the recorded digest, so that neither a forged database
# nor a link in a forged directory opens another file.

_PATH = re.compile(
    rf"{files.FOLDER}/[a-z_]{{1,40}}/[0-9]{{1,9}}/([a-z_]{{1,40}})\.([0-9]{{1,9}})\.[a-z]+\.[0-9]+\.mcap"
)


def recorded_file(directory: Path, path: str) -> bytes | None:
    """Return a recorded trajectory file by its path in the run directory; None if `path` is not that of one.

    Raises:
        EvidenceError: the file is not the recorded one.
        JournalError: the database cannot be read.

    """
    found = _PATH.fullmatch(path)
    facts = rollouts_of(directory, found[1], int(found[2])) if found else []
    fact = next((fact for fact in facts if fact.path == path), None)
    if fact is None or not _is_plain(directory, fact.path, fact.size):
        return None
    return files.read_evidence(directory, fact.path, fact.sha256)


def certificate(directory: Path, name: str) -> bytes | None:
    """Return the certificate; None if there is none."""
    return (directory / name).read_bytes() if _is_plain(directory, name, MAX_CERTIFICATE) else None


def _is_plain(directory: Path, relative: str, most: int) -> bool:
    """Return whether this is a regular file of at most `most` bytes, reached without a link in the directory."""
    path = directory.resolve() / relative
    try:
        state = path.lstat()
        # A FIFO would block its reader; a path that resolves elsewhere has a link on the way.
        return stat.S_ISREG(state.st_mode) and state.st_size <= most and path.resolve() == path
    except OSError:
        return False
