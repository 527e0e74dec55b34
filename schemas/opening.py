"""The way to a link: one try after the other until it opens, and the lines while there is none."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Literal, TypeVar

from .link import Tls
from .reminder import Reminder
from .unanswered import no_link

PAUSE = 0.3
"""Seconds between two tries, each of which takes a second where nothing answers."""
FIRST = 5.0
"""Seconds without a link until the first line."""

Session = TypeVar("Session")


def first_opened(
    configs: Iterator[str],
    open_session: Callable[[str], Session],
    refused: type[Exception],
    waiting: Callable[[], None],
) -> Session:
    """Return the first session that opens, with each of `configs` in turn; `waiting` is called after each other try.

    `open_session` raises `refused` if it does not open, within a second: Zenoh's own endless try ignores Ctrl-C.
    `waiting` may raise anything.
    """
    while True:
        try:
            return open_session(next(configs))
        except refused:
            waiting()
            time.sleep(PAUSE)


class LinkLines:
    """The lines of a side without a link: the reason, ever more rarely, and once that there is one again.

    The first line comes `first` s after the first call of `down`. Not thread-safe.
    """

    def __init__(
        self,
        endpoints: Sequence[str],
        side: Literal["worker", "orchestrator"],
        tls: Tls | None,
        print_line: Callable[[str], None],
        *,
        first: float = FIRST,
    ) -> None:
        self._endpoints, self._side, self._tls = endpoints, side, tls
        self._print_line, self._first = print_line, first
        self._reminder: Reminder | None = None

    def down(self) -> None:
        """Print why there is no link, if a line is due; that may take seconds for each endpoint."""
        self._reminder = self._reminder or Reminder(self._first, now=time.monotonic())
        if self._reminder.is_due(time.monotonic()):
            self._print_line(no_link(self._endpoints, self._side, self._tls))

    def up(self) -> None:
        """Print that there is a link, if a line said that there was none."""
        if self._reminder is not None and self._reminder.printed:
            self._print_line(f"connected to {' or '.join(self._endpoints)}")
        self._reminder = None
