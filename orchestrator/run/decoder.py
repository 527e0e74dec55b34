"""The decoding of large results beside the loop, which meanwhile takes heartbeats and hands out rollouts."""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ...schemas.batch import BatchRequest
from ...schemas.errors import EvidenceError
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory.batch import Batch
from ...schemas.trajectory.trajectory import Trajectory
from ..campaign.admission import admit_either
from ..fleet.link.transport import Result

LARGE = 2**20
"""Bytes of a result from which decoding takes longer than the way to another thread and back."""
Key = tuple[str, str, int]
"""Worker, rollout and attempt."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """A large result, and its trajectory or why it has none."""

    at: float
    result: Result
    found: Trajectory | Batch | EvidenceError


class Decoder:
    """Admits results against their requests in a thread of its own; everything else is for the loop."""

    def __init__(self, columns: tuple[str, ...], done: Callable[[Decoded], None]) -> None:
        self._columns, self._done = columns, done
        self._waiting: queue.SimpleQueue[tuple[Result, RolloutRequest | BatchRequest]] = queue.SimpleQueue()
        self._pending: dict[Key, float] = {}
        self._thread: threading.Thread | None = None

    @property
    def oldest(self) -> float:
        """Time of receipt of the oldest result that is not decided on; infinite without one.

        No limit of a worker may pass it: the worker is done, and has no more progress to report.
        """
        return min(self._pending.values(), default=float("inf"))

    def submit(self, result: Result, request: RolloutRequest | BatchRequest) -> None:
        """Decode a result; the same one that is delivered again meanwhile is dropped."""
        if (key := _key_of(result)) in self._pending:
            return
        self._pending[key] = result.at
        self._waiting.put((result, request))
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="decoder", daemon=True)
            self._thread.start()

    def finish(self, decoded: Decoded) -> None:
        """Take a decoded result off the list of those that wait."""
        self._pending.pop(_key_of(decoded.result), None)

    def _work(self) -> None:
        while True:
            result, request = self._waiting.get()
            found: Trajectory | Batch | EvidenceError
            try:
                found = admit_either(request, self._columns, result.payload, result.header.sha256)
                if isinstance(found, Batch):
                    _ = found.digests  # which the loop needs of every batch
            except EvidenceError as fault:
                found = fault.with_traceback(None)  # whose frames hold megabytes
            self._done(Decoded(time.monotonic(), result, found))
            del result, found


def _key_of(result: Result) -> Key:
    return result.worker, result.header.rollout, result.header.attempt
