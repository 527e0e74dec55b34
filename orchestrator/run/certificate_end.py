"""Lines about the end of the certificate with which a link was opened: its links close then, and none opens again."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

from ...schemas.certificates import read_certificates, time_text

SOON = timedelta(days=2)
"""Before the end, a line says that it comes."""


@contextmanager
def end_announced(path: str | None, print_line: Callable[[str], None]) -> Iterator[None]:
    """Print a line when the certificate in a file ends soon, and one when it has ended, while the block runs.

    Without a file there is nothing to print.

    Raises:
        LinkError: it is no certificate.

    """
    if path is None:
        yield
        return
    end = read_certificates(path)[0].not_valid_after_utc
    lines = (
        (end - SOON, f"{path}: this certificate ends at {time_text(end)}, and the links close then; issue a new one"),
        (end, f"{path}: this certificate has ended, and no link opens any more; start again with a new one"),
    )
    now = datetime.now(UTC)
    timers = [
        threading.Timer(min(max((moment - now).total_seconds(), 0.0), threading.TIMEOUT_MAX), print_line, [line])
        for moment, line in lines
    ]
    try:
        for timer in timers:
            timer.daemon = True
            timer.start()
        yield
    finally:
        for timer in timers:
            timer.cancel()
