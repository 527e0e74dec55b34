"""The one limit of every wait in a test.

Tests wait for events, never for a time; the limit ends a test that hangs. A busy machine is slow, not wrong, so the
limit is far above what any event takes on one.
"""

import time
from collections.abc import Callable

PATIENCE = 300.0
"""Seconds."""


def patience() -> Callable[[], bool]:
    """Return whether what begins now has taken longer than any test waits."""
    end = time.monotonic() + PATIENCE
    return lambda: time.monotonic() > end
