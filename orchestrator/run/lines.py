"""The lines of a run for its listeners: those that messages of peers cause are limited."""

import time
from collections.abc import Callable

from ...schemas.errors import one_line
from ...schemas.failure import Failure
from ...schemas.ids import RolloutId
from ..fleet.dispatch import events
from .throttle import Throttle


class Lines:
    """The log of one run; `print_line` passes a line to every listener."""

    def __init__(self, print_line: Callable[[str], None]) -> None:
        self.print_line = print_line
        self._throttle = Throttle()
        self._was_full = False
        self._failed: set[tuple[RolloutId, Failure]] = set()

    def refused(self, worker: str, reason: str) -> None:
        """Print that a worker is refused."""
        self._about(worker, "refused workers", f"refused worker {worker}: {reason}")

    def ignored(self, worker: str, reason: str) -> None:
        """Print that a message is not acceptable."""
        self._about(worker, "ignored messages", f"ignored a message of {worker}: {reason}")

    def too_many(self, worker: str, most: int) -> None:
        """Print that a worker gets no work because there are `most`; a line for all of them together."""
        if self._was_full:
            return
        self._was_full = True
        self.print_line(
            f"worker {worker}, and those that come after it, get no work: {most:,} workers are there, the most of one "
            "campaign; end them, or start them with --run ID for another campaign"
        )

    def failed(self, found: events.Fail) -> None:
        """Print a failed attempt, once: attempts that fail alike are counted in the database."""
        attempt, failure = found.attempt, found.failure
        if (attempt.rollout, failure) in self._failed:
            return
        self._failed.add((attempt.rollout, failure))
        # The reason is text of a system under test.
        reason = one_line(failure.reason)
        which = f"{attempt.rollout}, attempt {attempt.number} on {found.worker}"
        self._about(found.worker, "failed attempts", f"{which}, {failure.kind} failure: {reason}")

    def summarise(self) -> None:
        """Print how many lines were left out; called every tick."""
        for line in self._throttle.summaries(time.monotonic()):
            self.print_line(line)

    def _about(self, worker: str, kind: str, line: str) -> None:
        if self._throttle.admits(time.monotonic(), kind, worker):
            self.print_line(line)
