"""The routes for programs that watch a campaign: numbers for Prometheus, probes of Kubernetes or a load balancer.

| probe      | 200 `ok`                                              | 503                                         |
|------------|-------------------------------------------------------|---------------------------------------------|
| `/healthz` | this process serves, and the loop of its run lives    | the loop was silent for `SILENT` s; no text |
| `/readyz`  | the database can be read, and the loop sent something | `starting`, `stalled` or `unreadable`       |
|            | within the last `RECENT` s                            |                                             |

A page without a run, of a finished campaign for example, lives while it serves, and is ready while it can read.
"""

from anyio import to_thread
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from ....schemas.errors import PerfboundError
from .metrics import CampaignMetrics
from .run_feed import RECENT, SILENT, RunFeed
from .security import HEALTH

ALIVE = "ok"


def watching_routes(metrics: CampaignMetrics, feed: RunFeed | None) -> list[Route]:
    """Return the routes of one campaign; `feed` is that of the orchestrator whose page this is."""
    web = _WatchingEndpoints(metrics, feed)
    return [Route("/metrics", web.metrics), Route(HEALTH, web.alive), Route("/readyz", web.ready)]


class _WatchingEndpoints:
    """The responses of these routes."""

    def __init__(self, metrics: CampaignMetrics, feed: RunFeed | None) -> None:
        self._metrics, self._feed = metrics, feed

    async def metrics(self, request: Request) -> Response:
        text, media_type = await to_thread.run_sync(self._metrics.exposition, request.headers.get("accept", ""))
        # As a header, not as a media type: that would get a second character set.
        return Response(text, headers={"Content-Type": media_type})

    async def alive(self, _: Request) -> Response:
        stalled = self._feed is not None and self._feed.silent_for(SILENT)
        return _word("", 503) if stalled else _word(ALIVE, 200)

    async def ready(self, _: Request) -> Response:
        if self._feed is not None and self._feed.figures is None:
            return _word("starting", 503)
        if self._feed is not None and self._feed.silent_for(RECENT):
            return _word("stalled", 503)
        try:
            await to_thread.run_sync(self._metrics.refresh)
        except (PerfboundError, OSError):
            return _word("unreadable", 503)
        return _word(ALIVE, 200)


def _word(word: str, status: int) -> Response:
    return PlainTextResponse(word, status)
