"""What has been received and not been handled yet: bounded, so that no peer fills the memory.

Nothing here blocks a reader thread, since heartbeats and tokens of other workers may wait behind it: what is above a
limit is dropped. Results are delivered again until they are acknowledged, and heartbeats follow one another: of either
only the newest one waits, in the place of the first, so that a loop with much to do does not fall behind by repeats.
"""

import queue
import threading
import weakref
from collections import Counter, deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from ....schemas.errors import MessageError
from ....schemas.link.messages import MAX_RESULT

RESULTS_OF_WORKER = MAX_RESULT
"""Bytes of the results of one worker that are in memory."""
RESULTS = 2 * MAX_RESULT
"""Bytes of the results of all workers."""
MESSAGES_OF_WORKER = 256
"""Messages of one worker that wait."""
MESSAGES = 100_000
"""Messages of all workers."""


class _Sent(Protocol):
    @property
    def worker(self) -> str: ...


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Replaceable:
    """The place of a message that a newer one with the same key replaces while it waits."""

    at: float
    """Of the first one."""
    key: Hashable


class Inbox(Generic[T]):
    """A queue between reader threads and one loop; tokens are never dropped before `MESSAGES` wait."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[T | _Replaceable] = queue.SimpleQueue()
        self._newest: dict[Hashable, T] = {}
        self._waiting: Counter[str] = Counter()
        self._lock = threading.Lock()
        self.complete = 0.0
        """Time up to which the messages taken are all that came, as far as that is known; 0 if it is not."""

    def put(self, message: T) -> None:
        """Add a message, or drop it; those of the program itself, without a worker, always find a place.

        One with a key, its attribute `replaces`, takes the place of the one with the same key that waits.
        """
        worker, key = getattr(message, "worker", None), getattr(message, "replaces", None)
        if worker is None:
            self._queue.put(message)
            return
        with self._lock:
            # In the place of the first: at the end of the queue a worker that is always replaced would never be heard.
            if key in self._newest:
                self._newest[key] = message
                return
            if self._waiting[worker] >= MESSAGES_OF_WORKER or self._queue.qsize() >= MESSAGES:
                return
            self._waiting[worker] += 1
            if key is not None:
                self._newest[key] = message
        self._queue.put(message if key is None else _Replaceable(getattr(message, "at", 0.0), key))

    @property
    def waiting(self) -> int:
        """Number of the messages that wait."""
        return self._queue.qsize()

    def get(self, timeout: float) -> T:
        """Return the next message, at once if `timeout` in s is not positive; raises `queue.Empty`."""
        entry = self._queue.get(timeout=timeout) if timeout > 0 else self._queue.get_nowait()
        # Only up to the first of those that it replaces: nobody counts as hung whose progress waits behind this entry.
        self.complete = getattr(entry, "at", 0.0)
        with self._lock:
            message = self._newest.pop(entry.key) if isinstance(entry, _Replaceable) else entry
            worker = getattr(message, "worker", None)
            if worker is not None:
                self._waiting[worker] -= 1
                if self._waiting[worker] <= 0:
                    del self._waiting[worker]
        return message


class Budget:
    """The bytes of results in memory; any thread may use it."""

    def __init__(self, of_worker: int = RESULTS_OF_WORKER, whole: int = RESULTS) -> None:
        self._limits = of_worker, whole
        self._held: Counter[str] = Counter()
        self._given_back: deque[tuple[str, int]] = deque()
        self._lock = threading.Lock()

    def reserve(self, worker: str, size: int) -> None:
        """Make room for a result that is about to be read.

        Raises:
            MessageError: there is none now.

        """
        of_worker, whole = self._limits
        with self._lock:
            self._settle()
            if self._held[worker] + size > of_worker or self._held.total() + size > whole:
                raise MessageError(f"a result of {size} bytes was dropped unread, because too many wait already")
            self._held[worker] += size

    def release_with(self, result: _Sent, size: int) -> None:
        """Give the room back when nothing holds the result any more, wherever it is then."""
        # No explicit call: it may be in the queue, the decoder or the admission, and no exception may leak room.
        weakref.finalize(result, self._release, result.worker, size)

    @property
    def held(self) -> int:
        """Bytes in memory now."""
        with self._lock:
            self._settle()
            return self._held.total()

    def _release(self, worker: str, size: int) -> None:
        # A finalizer may run anywhere, also in a thread that holds the lock: it takes none, and appending is atomic.
        self._given_back.append((worker, size))

    def _settle(self) -> None:
        while self._given_back:
            worker, size = self._given_back.popleft()
            self._held[worker] -= size
            if self._held[worker] <= 0:
                del self._held[worker]
