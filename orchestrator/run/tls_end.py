"""Lines about the end of the certificate with which a link was opened: its links close then, and none opens again."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial

from ...schemas.link.tls_files import read_certificates, time_text

SOON = timedelta(days=2)
"""Before the end, a line says that it comes."""
AFTER = timedelta(seconds=1)
"""After the end nothing opens; within its second a link that Zenoh has just closed may open again, and then stays."""


@contextmanager
def end_announced(
    path: str | None, print_line: Callable[[str], None], at_end: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Print a line when the certificate in a file ends soon, and one when it has ended, while the block runs.

    `at_end` is called, on another thread, when no link can open any more. Without a file there is nothing to do.

    Raises:
        LinkError: it is no certificate.

    """
    if path is None:
        yield
        return
    end = read_certificates(path)[0].not_valid_after_utc
    soon = f"{path}: this certificate ends at {time_text(end)}, and the links close then; issue a new one"
    over = f"{path}: this certificate has ended, and no link opens any more; start again with a new one"
    events = ((end - SOON, partial(print_line, soon)), (end, partial(print_line, over)), (end + AFTER, at_end))
    now = datetime.now(UTC)
    timers = [
        threading.Timer(min(max((moment - now).total_seconds(), 0.0), threading.TIMEOUT_MAX), act)
        for moment, act in events
    ]
    try:
        for timer in timers:
            timer.daemon = True
            timer.start()
        yield
    finally:
        for timer in timers:
            timer.cancel()
