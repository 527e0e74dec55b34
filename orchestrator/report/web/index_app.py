"""The index of the campaigns below a folder as a web application: read-only, as restricted as the page of one.

| route              | response                                                                       |
|--------------------|--------------------------------------------------------------------------------|
| `/`                | the page with all campaigns                                                    |
| `/campaigns.json`  | `?seen=STAMP`: what changed since that answer, 204 if nothing did; else all    |
| `/runs/PATH/...`   | the page of the campaign in a folder, with the routes of the page of one       |
| `/metrics`         | no numbers: those of a campaign are below `/runs/PATH/`                        |
| `/healthz`, `/readyz` | whether the page lives, and whether it has read the folder                  |

A path is looked up among the campaigns that were found; it is never opened.
"""

import os
import re
import shlex
import time
from pathlib import Path
from urllib.parse import quote, unquote_to_bytes

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from ....schemas.errors import one_line
from ...run.page.address import Address
from ...run.page.page_access import OPEN, PageAccess
from .. import html as document
from ..listing import DEPTH
from .app import JSON, plain
from .campaign_index import PREFIX
from .index_cache import IndexCache
from .open_campaigns import OpenCampaigns
from .security import restricted
from .watching import ALIVE

_SEEN = re.compile("([0-9a-f]{16})-([0-9]{1,9})")
_OF_OUTER_ROUTE = {"app", "router", "endpoint", "path_params", "route"}


def index_application(
    index: IndexCache, campaigns: OpenCampaigns, address: Address, access: PageAccess = OPEN
) -> ASGIApp:
    """Return the application for the campaigns of an index, served at `address`."""
    web = _IndexEndpoints(index)
    routes = [
        Route("/", web.page),
        Route("/campaigns.json", web.changes),
        Route("/metrics", _no_metrics),
        Route("/healthz", _alive),
        Route("/readyz", web.ready),
        Route(f"/{PREFIX}{{rest:path}}", _CampaignPages(index, campaigns)),
    ]
    web_application = Starlette(routes=routes, exception_handlers={500: web.internal_error})
    return restricted(web_application, address, access)


async def _no_metrics(_: Request) -> Response:
    return plain(f"the metrics are those of one campaign; ask for /{PREFIX}FOLDER/metrics", 404)


async def _alive(_: Request) -> Response:
    return plain(ALIVE, 200)


class _IndexEndpoints:
    """The responses of the index itself."""

    def __init__(self, index: IndexCache) -> None:
        self._cache = index
        self._server = os.urandom(8).hex()
        """Of this process: the numbers of another one mean other moments."""

    async def page(self, _: Request) -> Response:
        await self._cache.refreshed()
        title = f"Campaigns in {one_line(str(self._cache.index.folder))}"
        html, policy = document.index_page(title, self._changes(-1))
        return HTMLResponse(html, headers={"Content-Security-Policy": f"{policy}; frame-ancestors 'none'"})

    async def changes(self, request: Request) -> Response:
        await self._cache.refreshed()
        found = _SEEN.fullmatch(request.query_params.get("seen", ""))
        seen = int(found[2]) if found and found[1] == self._server else -1
        if seen == self._cache.index.number:
            return Response(status_code=204)
        return Response(self._changes(seen), media_type=JSON)

    async def ready(self, _: Request) -> Response:
        await self._cache.refreshed()
        return plain(ALIVE, 200)

    def _changes(self, seen: int) -> str:
        found, folder = self._cache.index.since(seen), self._cache.index.folder
        return found.to_json(
            stamp=f"{self._server}-{found.number}",
            folder=one_line(str(folder)),
            start=shlex.join(["perfbound", "run", "CAMPAIGN.toml", "--out", str(folder / "first")]),
            now=time.time(),
        )

    async def internal_error(self, request: Request, error: Exception) -> Response:
        if not request.url.path.startswith(f"/{PREFIX}"):  # the page of a campaign reports its own
            self._cache.report(f"{request.url.path}: {error!r}")
        return plain("internal error; see the output of perfbound", 500)


class _CampaignPages:
    """The pages of the campaigns: each request goes to the application of the campaign that its path begins with."""

    def __init__(self, index: IndexCache, campaigns: OpenCampaigns) -> None:
        self._cache, self._campaigns = index, campaigns

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        parts = unquote_to_bytes(scope["raw_path"]).removeprefix(f"/{PREFIX}".encode()).split(b"/")
        found = self._found(parts)
        if found is None:  # it may be new, and the server too
            await self._cache.refreshed()
            found = self._found(parts)
        answer: ASGIApp
        if found is None:
            answer = plain("there is no such campaign, or no longer; the index has those that there are", 404)
        elif found[1] == len(parts):
            # The addresses in a page are relative to its folder.
            answer = RedirectResponse(f"/{PREFIX}{quote(b'/'.join(parts))}/")
        else:
            directory, length = found
            opened = self._campaigns.application(directory, "../" * (length + 1))
            answer = opened or plain("too many campaigns are open; close the page of one and reload this one", 503)
            scope = _request_below(scope, b"/".join(parts[length:]))
        await answer(scope, receive, send)

    def _found(self, parts: list[bytes]) -> tuple[Path, int] | None:
        """Return the run directory that a path begins with, and how many of its parts that are."""
        for length in range(1, min(len(parts), DEPTH) + 1):
            if (directory := self._cache.index.directory(b"/".join(parts[:length]))) is not None:
                return directory, length
        return None


def _request_below(scope: Scope, rest: bytes) -> Scope:
    """Return a request as one for the rest of its path, without the marks of the route that it came by."""
    kept = {name: value for name, value in scope.items() if name not in _OF_OUTER_ROUTE}
    return {**kept, "path": f"/{rest.decode(errors='replace')}", "raw_path": b"/" + rest}
