"""The way to a link: one try after the other until it opens, and the lines while there is none."""

import time
from collections.abc import Callable, Iterator
from typing import TypeVar

PAUSE = 0.3
"""Seconds between two tries, each of which takes a second where nothing answers."""
UNLINKED = 5.0
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
