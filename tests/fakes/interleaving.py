"""Work that another thread does in the middle of something: what a lock is for."""

import threading
from collections.abc import Callable

WHILE = 0.3
"""Seconds for work that nothing holds up."""


def meanwhile(work: Callable[[], object]) -> threading.Thread:
    """Begin `work` in a thread of its own, and return when it has ended, or a lock holds it up."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(WHILE)
    return thread
