"""What the orchestrator of a run has last sent to its page, and how long ago that was."""

import time

from ...run.page.page_feed import RunFigures

RECENT = 10.0
"""Seconds since the last message in which a run is ready; messages come every second."""
SILENT = 60.0
"""Seconds without a message after which the loop of a run hangs: as long as its service manager waits for it."""


class RunFeed:
    """The last message of one orchestrator; any thread may use it."""

    def __init__(self) -> None:
        self._last: tuple[RunFigures, float] | None = None

    def take(self, figures: RunFigures) -> None:
        """Take a message."""
        self._last = figures, time.monotonic()

    @property
    def figures(self) -> RunFigures | None:
        """The last message; None before the first one."""
        return self._last[0] if self._last else None

    def silent_for(self, seconds: float) -> bool:
        """Whether the loop has sent nothing for longer than this.

        It has nothing to send before its first turn, while it reads the database, and after its last one, while the
        certificate is made; if the orchestrator dies then, the feed ends, and the page with it.
        """
        # A kill while a large database is replayed, or a certificate is made, would be repeated without end.
        last = self._last
        return last is not None and not last[0].done and time.monotonic() - last[1] > seconds
