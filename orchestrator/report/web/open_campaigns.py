"""The campaigns of an index whose pages were opened last: their data stays in memory, that of others does not."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

from starlette.types import ASGIApp

from ..collect.campaign import Collector
from .app import ServerLimits, campaign_application
from .snapshots import SnapshotCache

MOST_OPEN = 8
"""Campaigns in memory: the facts of a large one take 100 MB."""


class OpenCampaigns:
    """The applications of at most `MOST_OPEN` campaigns; use from one event loop.

    Of all of them one refreshes its data at a time. `report` takes every error as one line.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._limits = ServerLimits()
        self._one_at_a_time = asyncio.Lock()
        self._open: OrderedDict[Path, tuple[SnapshotCache, ASGIApp]] = OrderedDict()

    def application(self, directory: Path, index: str) -> ASGIApp | None:
        """Return the application of a campaign; None while all that are open have readers.

        `index` is the relative address of the index, for the way back.
        """
        if directory not in self._open:
            if len(self._open) >= MOST_OPEN and not self._closed_one():
                return None
            snapshots = SnapshotCache(Collector(directory), self._report, self._one_at_a_time)
            self._open[directory] = snapshots, campaign_application(directory, snapshots, self._limits, index)
        self._open.move_to_end(directory)
        return self._open[directory][1]

    def close(self) -> None:
        """Let every stream send its last snapshot, and end."""
        for snapshots, _ in self._open.values():
            snapshots.closing.set()

    def _closed_one(self) -> bool:
        """Drop the campaign that nobody reads and that was asked for the longest time ago; False if there is none."""
        idle = next((directory for directory in self._open if not self._limits.streams[directory]), None)
        if idle is None:
            return False
        del self._open[idle]
        return True
