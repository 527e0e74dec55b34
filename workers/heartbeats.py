"""The times at which a worker sends its heartbeats."""

import time

from .transport import Uplink


class Heartbeats:
    """When the next heartbeat is due, for a thread that asks every `period` s; any thread may set the interval."""

    def __init__(self, uplink: Uplink, period: float) -> None:
        self._uplink, self._period = uplink, period
        self._orchestrators: list[tuple[str, str]] | None = None
        self._next = float("-inf")
        self.interval = period
        """Seconds."""

    def due(self, *, at_once: bool) -> bool:
        """Whether to send one now, which is then counted as sent; `at_once` whether something has changed."""
        now, orchestrators = time.monotonic(), self._uplink.orchestrators()
        if orchestrators != self._orchestrators:
            # Another one, or this one after the link was down: it has sent no interval, and waits for a report.
            self._orchestrators, self.interval, at_once = orchestrators, self._period, True
        if not at_once and now < self._next:
            return False
        # A wait may end a little early, and the heartbeat would be late by another one.
        self._next = now + self.interval - self._period / 2
        return True
