"""The orchestrator's side of `perfbound stop`: a request in the run directory becomes an event of the loop."""

import signal
from collections.abc import Callable
from pathlib import Path

from ..store import stop_request
from .service import Interrupted, RunStatus


class StopRequests:
    """A listener that examines the run directory at every tick, and hands a request to `put`, the loop's own inbox."""

    def __init__(self, directory: Path, print_line: Callable[[str], None]) -> None:
        self.put: Callable[[Interrupted], None] | None = None
        self._directory, self._print_line = directory, print_line

    def print_line(self, line: str) -> None:
        """Drop the line: another listener prints it."""

    def show(self, status: RunStatus) -> None:  # noqa: ARG002
        """Take a request, if there is one."""
        manner = stop_request.take_request(self._directory)
        if manner is None or self.put is None:
            return
        self._print_line("`perfbound stop` has asked for the end of this run")
        # As Ctrl-C: a library gets its KeyboardInterrupt, and a command ends with 130.
        self.put(Interrupted(signal.SIGINT, drain=manner == "drain"))
