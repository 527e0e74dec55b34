"""The live page as a web application: read-only, and closed to whoever is not invited.

| route                  | what it gives                                                        |
|------------------------|----------------------------------------------------------------------|
| `/`                    | the page, with the story of the moment                               |
| `/events`              | the story again whenever it has changed, as server-sent events       |
| `/story.json`          | the story                                                            |
| `/scene`               | `?problem=NAME&test=N`: the rollouts of one test, as curves          |
| `/trajectories/...`    | the file of a recorded rollout                                       |
| `/certificate.json`    | the certificate, once there is one                                   |
| `/counterexamples.csv` | the rollouts with robustness below 0                                 |
"""

import io
import re
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path

from anyio import CapacityLimiter, to_thread
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from ....schemas.errors import EvidenceError, PerfboundError, one_line
from ...certificate.files import CERTIFICATE
from ...store import export
from ...store.files import FOLDER
from .. import html as document
from . import files
from .hosts import Guard, Hosts
from .snapshots import SnapshotCache

MOST_STREAMS = 32
MOST_FILES = 4
"""Files that are read at a time."""
KEEP_ALIVE = 15.0
"""Seconds of silence after which a stream says that it lives."""
RETRY, STILL_HERE = b"retry: 1000\n\n", b": still here\n\n"
JSON, EVENTS = "application/json", "text/event-stream"
_NUMBER = re.compile("[0-9]{1,9}")


def application(directory: Path, looks: SnapshotCache, hosts: Hosts) -> ASGIApp:
    """Return the application for the campaign in `directory`."""
    web = _Web(directory, looks)
    routes = [
        Route("/", web.page),
        Route("/events", web.events),
        Route("/story.json", web.story),
        Route("/scene", web.scene),
        Route(f"/{FOLDER}/{{rest:path}}", web.trajectory),
        Route(f"/{CERTIFICATE}", web.certificate),
        Route("/counterexamples.csv", web.counterexamples),
    ]
    return Guard(Starlette(routes=routes, exception_handlers={PerfboundError: _unreadable, 500: web.fault}), hosts)


class _Web:
    def __init__(self, directory: Path, looks: SnapshotCache) -> None:
        self._directory, self._looks = directory, looks
        self._files = CapacityLimiter(MOST_FILES)
        self._streams = 0

    async def page(self, _: Request) -> Response:
        look = await self._looks.fresh()
        html, policy = document.live(look.title, look.story)
        return HTMLResponse(html, headers={"Content-Security-Policy": f"{policy}; frame-ancestors 'none'"})

    async def story(self, _: Request) -> Response:
        return Response((await self._looks.fresh()).story, media_type=JSON)

    async def scene(self, request: Request) -> Response:
        problem, test = request.query_params.get("problem", ""), request.query_params.get("test", "")
        if not _NUMBER.fullmatch(test):
            return _text("ask for /scene?problem=NAME&test=NUMBER", 400)
        try:
            return Response(await self._looks.scene(problem, int(test)), media_type=JSON)
        except PerfboundError as error:
            return _text(str(error), 404)

    async def trajectory(self, request: Request) -> Response:
        asked = f"{FOLDER}/{request.path_params['rest']}"
        return await self._file(partial(files.trajectory, self._directory, asked), "application/octet-stream")

    async def certificate(self, _: Request) -> Response:
        return await self._file(partial(files.certificate, self._directory, CERTIFICATE), JSON)

    async def counterexamples(self, _: Request) -> Response:
        return await self._file(self._counterexamples, "text/csv")

    def _counterexamples(self) -> bytes:
        out = io.BytesIO()
        export.stream(self._directory, "counterexamples", out)
        return out.getvalue()

    async def _file(self, read: Callable[[], bytes | None], media_type: str) -> Response:
        try:
            data = await to_thread.run_sync(read, limiter=self._files)
        except EvidenceError as error:
            return _text(str(error), 404)
        if data is None:
            return _text("there is no such file, or not yet", 404)
        return Response(data, media_type=media_type, headers={"Content-Disposition": "attachment"})

    async def fault(self, request: Request, error: Exception) -> Response:
        self._looks.say(f"{request.url.path}: {error!r}")
        return _text("this failed; the page's owner sees why", 500)

    async def events(self, request: Request) -> Response:
        if self._streams >= MOST_STREAMS:
            return _text(f"{MOST_STREAMS} pages of this campaign are open; close one and load this one again", 503)
        if request.method == "HEAD":
            return Response(media_type=EVENTS)
        self._streams += 1
        return _Counted(self._stream(), self._gone)

    def _gone(self) -> None:
        self._streams -= 1

    async def _stream(self) -> AsyncIterator[bytes]:
        """Yield the story whenever it has changed, and at the end; who is slow misses what came between."""
        seen, spoke = -1, time.monotonic()
        yield RETRY
        while True:
            last = self._looks.closing.is_set()
            look = await self._looks.latest()
            if look is not None and look.number != seen:
                seen, spoke = look.number, time.monotonic()
                yield f"event: story\nid: {seen}\ndata: {look.story}\n\n".encode()
            elif time.monotonic() - spoke >= KEEP_ALIVE:
                spoke = time.monotonic()
                yield STILL_HERE
            if last:
                return
            await self._looks.pause(KEEP_ALIVE)


class _Counted(StreamingResponse):
    """A stream that is counted until it ends, however it ends."""

    def __init__(self, content: AsyncIterator[bytes], gone: Callable[[], None]) -> None:
        super().__init__(content, media_type=EVENTS)
        self._gone = gone

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._gone()


def _text(text: str, status: int) -> Response:
    return PlainTextResponse(one_line(text) + "\n", status)


def _unreadable(_: Request, error: Exception) -> Response:
    return _text(str(error), 503)
