"""What a campaign needs of the process that it runs in: one thread of BLAS, its signals, a console."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.text import Text
from threadpoolctl import threadpool_limits

from ..schemas.errors import Stopped


@contextmanager
def reproducible() -> Iterator[None]:
    """Have BLAS use one thread inside: the last digits of a certificate must not depend on the number of cores."""
    import scipy.linalg  # noqa: F401, PLC0415  (its BLAS has to be there before it can be limited)

    from ..orchestrator.campaign import ledger  # noqa: F401, PLC0415

    with threadpool_limits(1):
        yield


@contextmanager
def interruptible(directory: Path, console: Console) -> Iterator[None]:
    """Turn a signal that stopped the campaign into an interrupt, after a line on how to continue.

    Raises:
        KeyboardInterrupt: SIGINT came.
        SystemExit: SIGTERM came.

    """
    main = threading.current_thread() is threading.main_thread()
    before = [(number, signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM) if main]
    try:
        yield
    except Stopped as stopped:
        text = f"stopped; perfbound.resume({str(directory)!r}) continues"
        console.print(Text(text), soft_wrap=True)
        if stopped.signal == signal.SIGINT:
            raise KeyboardInterrupt(text) from None
        raise SystemExit(128 + stopped.signal) from None
    finally:
        # The session leaves them ignored, because a command ends with it; a notebook continues.
        for number, handler in before:
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def output(*, progress: bool) -> Console:
    """Return the console of the progress: the output of the cell in a notebook, stderr elsewhere."""
    return Console(stderr=True) if progress else Console(quiet=True, force_terminal=False)
