"""A rate-limited refresh of the index of campaigns, shared by all clients, none of which waits long for it."""

import asyncio
import time
from collections.abc import Callable

from anyio import to_thread

from .campaign_index import CampaignIndex

READING = 0.7
"""Seconds of a refresh in which campaigns are read; the rest of a large folder follows in the next ones."""
PATIENCE = 0.9
"""Seconds that a client waits for a refresh; afterwards it gets what there is."""
SHORTEST_PAUSE = 1.0
PAUSES = 3.0
"""The pause after a refresh is so many times its duration, and at least the shortest one."""


class IndexCache:
    """Refreshes an index on request, one refresh at a time; use from one event loop."""

    def __init__(self, index: CampaignIndex, report: Callable[[str], None]) -> None:
        self.index, self.report = index, report
        self._task: asyncio.Task[None] | None = None
        self._due = 0.0
        self._error = ""

    async def refreshed(self) -> None:
        """Refresh the index if it is due, and wait a short time for that."""
        self.begin()
        if self._task is not None:
            await asyncio.wait({self._task}, timeout=PATIENCE)

    def begin(self) -> None:
        """Begin to refresh the index if it is due."""
        if self._task is None and time.monotonic() >= self._due:
            self._task = asyncio.get_running_loop().create_task(self._refresh())
            self._task.add_done_callback(self._ended)

    def _ended(self, _: "asyncio.Task[None]") -> None:
        self._task = None

    async def _refresh(self) -> None:
        began = time.monotonic()
        try:
            await to_thread.run_sync(self.index.refresh, READING)
        except Exception as error:  # noqa: BLE001  (any: the page stays, with what it has)
            if str(error) != self._error:  # the same error every second is reported once
                self._error = str(error)
                self.report(f"the index could not be refreshed: {error!r}")
        now = time.monotonic()
        self._due = now + (0.0 if self.index.unread else max(SHORTEST_PAUSE, PAUSES * (now - began)))
