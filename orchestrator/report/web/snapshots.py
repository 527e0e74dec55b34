"""Looks at one campaign, shared by all who watch it: at most one a second, and none when nobody asks."""

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from anyio import to_thread

from ....schemas.errors import PerfboundError
from ..data import ReportData, RolloutsOfTest, to_json
from ..workers import LiveState

PERIOD = 1.0
"""Seconds from the end of a look to the next one, at least."""
LONGEST = 5.0
"""As long as a look took is waited before the next one, at most so many s: half a processor is enough."""


class Tells(Protocol):
    """What is looked at; `Teller` in life. It is asked by one thread at a time."""

    def look(self, live: Mapping[str, LiveState] | None = None, at: float | None = None) -> ReportData:
        """Tell how the campaign stands, at the Unix time `at`; `live` is what the workers do."""
        ...

    def scene(self, problem: str, test: int) -> RolloutsOfTest:
        """Tell about one test."""
        ...


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What was seen."""

    number: int
    """Grows when something has changed, but for the time of the look."""
    title: str
    story: str
    """JSON."""


class SnapshotCache:
    """The one who looks; used from one event loop."""

    def __init__(self, teller: Tells, say: Callable[[str], None]) -> None:
        self.live: Mapping[str, LiveState] | None = None
        """What the workers do, where an orchestrator tells; set from any thread."""
        self.closing = asyncio.Event()
        self._teller, self.say = teller, say
        self._one_at_a_time = asyncio.Lock()
        self._due = 0.0
        self._ended = False
        self._last: Snapshot | None = None
        self._seen: ReportData | None = None
        self._trouble = ""

    async def latest(self) -> Snapshot | None:
        """Return the last look, or a new one when it is time for one; None if the campaign never could be read."""
        async with self._one_at_a_time:
            end = self.closing.is_set() and not self._ended  # a look that was under way then saw too little
            if end or time.monotonic() >= self._due:
                self._ended = end
                await to_thread.run_sync(self._look)
            return self._last

    async def fresh(self) -> Snapshot:
        """Return the latest look.

        Raises:
            PerfboundError: the campaign cannot be read, and never could.

        """
        look = await self.latest()
        if look is None:
            raise PerfboundError(self._trouble)
        return look

    async def scene(self, problem: str, test: int) -> str:
        """Return the scene of a test, as JSON.

        Raises:
            PerfboundError: there is no such test, or its files cannot be read.

        """
        async with self._one_at_a_time:
            return to_json(await to_thread.run_sync(self._teller.scene, problem, test))

    async def pause(self, most: float) -> None:
        """Wait until the next look, at most `most` s, or until the page closes."""
        try:
            await asyncio.wait_for(self.closing.wait(), min(most, max(0.0, self._due - time.monotonic())))
        except TimeoutError:
            return

    def close(self) -> None:
        """Let everybody take one last look and go."""
        self.closing.set()

    def _look(self) -> None:
        began = time.monotonic()
        try:
            self._take(self._teller.look(self.live, time.time()))
        except (PerfboundError, OSError) as error:
            self._complain(str(error))
        except Exception as error:  # noqa: BLE001  (a fault of ours: the page keeps what it has)
            self._complain(f"a look failed: {error!r}")
        now = time.monotonic()
        self._due = now + min(LONGEST, max(PERIOD, now - began))

    def _take(self, story: ReportData) -> None:
        seen = replace(story, updated=None)
        if seen != self._seen:
            number = self._last.number + 1 if self._last else 0
            self._last, self._seen = Snapshot(number, story.name, to_json(story)), seen

    def _complain(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self.say(trouble)
