"""A rate-limited cache of report snapshots, shared by all clients of a live page."""

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from anyio import to_thread

from ....schemas.errors import PerfboundError
from ...run.page.page_feed import LiveState
from ...run.routers import RouterLink
from ..collect.campaign import Collector
from ..collect.scenes import without_further
from ..data.page import ReportData, to_json

SHORTEST_PAUSE = 1.0
"""Seconds from the end of a refresh to the next one, at least."""
LONGEST_PAUSE = 5.0
"""The pause after a refresh equals its duration, up to this many seconds, so polling uses at most half a core."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The report data at one moment."""

    number: int
    """Grows with every change of the data, the time of the refresh excepted."""
    title: str
    json: str


class SnapshotCache:
    """Refreshes a collector at most once a second, and only on request; use from one event loop.

    A refresh that fails is reported once, and the last snapshot stays.
    """

    def __init__(
        self, collector: Collector, report: Callable[[str], None], one_at_a_time: asyncio.Lock | None = None
    ) -> None:
        self.live: Mapping[str, LiveState] | None = None
        """State of the workers, from the orchestrator if there is one; set from any thread."""
        self.link: RouterLink | None = None
        """Its link to the router; set from any thread."""
        self.closing = asyncio.Event()
        self.report = report
        self._collector = collector
        self._one_at_a_time = one_at_a_time or asyncio.Lock()  # of all campaigns of one server
        self._reading: asyncio.Task[Snapshot | None] | None = None
        """The last one for a page, which continues where the page does not wait for it."""
        self._due = 0.0
        self._final = False
        self._snapshot: Snapshot | None = None
        self._data: ReportData | None = None
        self.error = ""
        """Why the last refresh failed."""

    def abandon(self) -> None:
        """Show the campaign as one that no process runs, from the next refresh on: its orchestrator has ended."""
        self._collector.abandoned = True

    async def latest(self) -> Snapshot | None:
        """Return the last snapshot, or a new one when it is due; None if the campaign was never readable."""
        async with self._one_at_a_time:
            # One more refresh at the end: one that was in progress when the page closed may lack the last facts.
            final = self.closing.is_set() and not self._final
            if final or time.monotonic() >= self._due:
                self._final = final
                await to_thread.run_sync(self._refresh)
            return self._snapshot

    async def available(self) -> Snapshot:
        """Return the latest snapshot.

        Raises:
            PerfboundError: the campaign cannot be read and never could be.

        """
        snapshot = await self.latest()
        if snapshot is None:
            raise PerfboundError(self.error)
        return snapshot

    async def soon(self, most: float) -> Snapshot | None:
        """Return the latest snapshot; None if there is none within `most` s. Raises as `available`."""
        reading = self._reading
        if reading is None or reading.done():
            reading = self._reading = asyncio.create_task(self.latest())
        done, _ = await asyncio.wait({reading}, timeout=most)
        if done and reading.result() is None:
            raise PerfboundError(self.error)
        return reading.result() if done else None

    async def rollouts_of_test(self, problem: str, test: int) -> str:
        """Return the rollouts of a test as JSON.

        Raises:
            PerfboundError: there is no such test, or its files cannot be read.

        """
        async with self._one_at_a_time:
            return to_json(await to_thread.run_sync(self._collector.rollouts_of_test, problem, test))

    async def pause(self, most: float) -> None:
        """Wait until a refresh is due, at most `most` s, or until the page closes."""
        try:
            await asyncio.wait_for(self.closing.wait(), min(most, max(0.0, self._due - time.monotonic())))
        except TimeoutError:
            return

    def _refresh(self) -> None:
        began = time.monotonic()
        try:
            self._store(self._collector.refresh(self.live, time.time()))
        except (PerfboundError, OSError) as error:
            self._fail(str(error))
        except Exception as error:  # noqa: BLE001  (a bug in a refresh must not end the page)
            self._fail(f"the page could not be refreshed: {error!r}")
        now = time.monotonic()
        self._due = now + min(LONGEST_PAUSE, max(SHORTEST_PAUSE, now - began))

    def _store(self, data: ReportData) -> None:
        data = replace(data, scenes=without_further(data.scenes), link=self.link)
        timeless = replace(data, updated=None)
        if timeless != self._data:
            number = self._snapshot.number + 1 if self._snapshot else 0
            self._snapshot, self._data = Snapshot(number, data.name, to_json(data)), timeless

    def _fail(self, error: str) -> None:
        if error != self.error:  # the same error every second is reported once
            self.error = error
            self.report(error)
