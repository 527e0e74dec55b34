"""The sending side of a link, in a thread of its own: a peer that does not read holds up neither loop nor end."""

import queue
import threading
from collections.abc import Callable

from ....schemas.link.messages import Request

WAITING = 10_000
"""Messages that wait for the link; above that, new ones are dropped, which the protocol repeats."""
PATIENCE = 1.0
"""Seconds for the whole end of a link: the last messages, the link, its threads."""


class Sender:
    """Puts messages in their order; `put` may block for as long as a peer lets it."""

    def __init__(self, put: Callable[[str, Request], None]) -> None:
        self._put = put
        self._waiting: queue.SimpleQueue[tuple[str, Request] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="sender", daemon=True)
        self._thread.start()

    def send(self, worker: str, message: Request) -> None:
        """Send without waiting."""
        if self._waiting.qsize() < WAITING:
            self._waiting.put((worker, message))

    def finish(self) -> None:
        """Send what waits, as far as peers read it; half of the time is for what follows."""
        self._waiting.put(None)
        self._thread.join(PATIENCE / 2)

    def _work(self) -> None:
        while (message := self._waiting.get()) is not None:
            self._put(*message)


def within_patience(close: Callable[[], object]) -> None:
    """Call `close` in a thread that is not waited for if it takes longer; the end of the process ends it."""

    def attempt() -> None:
        try:
            close()
        except Exception:  # noqa: BLE001  (any: the link is given up, and the campaign is finished)
            return

    thread = threading.Thread(target=attempt, name="closing", daemon=True)
    try:
        thread.start()
        thread.join(PATIENCE)
    except BaseException:  # a signal is no reason to leave the link in the middle of its end
        if thread.is_alive():
            thread.join(PATIENCE)
        raise
