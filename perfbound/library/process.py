"""What a campaign needs of the process that it runs in: one thread of BLAS, its signals, a console."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.text import Text
from threadpoolctl import LibController, ThreadpoolController

from ..schemas.errors import Stopped
from ..schemas.stop_signals import stop_signals


class _OneThread:
    """The limit of BLAS to one thread, which all that computes at the same time shares.

    BLAS has one number of threads for the whole process: a limit for each thread of Python would be lifted by the first
    that ends, in the middle of the others, and the last one would leave the number of another behind.
    """

    def __init__(self) -> None:
        self._lock, self._inside = threading.Lock(), 0
        self._libraries: ThreadpoolController | None = None
        self._before: list[tuple[LibController, int]] = []

    def enter(self) -> None:
        with self._lock:
            if self._libraries is None:  # once: to find them takes milliseconds
                self._libraries = _numerics()
            if not self._inside:
                self._before = [(each, each.num_threads) for each in self._libraries.lib_controllers]
            for each, _ in self._before:  # not of the first alone: BLAS over OpenMP has a number for each thread
                _set(each, 1)
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            for each, threads in () if self._inside else self._before:
                _set(each, threads)

    def forked(self) -> None:
        """Begin anew in a fork: threads that computed, and may have held the lock, are not there."""
        self._lock = threading.Lock()


_one_thread = _OneThread()
os.register_at_fork(after_in_child=_one_thread.forked)


def _set(library: LibController, threads: int) -> None:
    # threadpoolctl gives OpenBLAS to one thread of Python for as long as that lives: of any other one it drops the
    # number without a word, and a campaign beside it computes many times as long.
    getattr(library, "_real_set_num_threads", library.set_num_threads)(threads)


def _numerics() -> ThreadpoolController:
    """Return the numbers of threads of every BLAS that computes here."""
    import scipy.linalg  # noqa: F401, PLC0415  (its BLAS has to be there before it can be limited)

    from ..orchestrator.campaign import ledger  # noqa: F401, PLC0415

    # Not by environment variables: numpy has read them by now, and they would stay for the rest of the notebook.
    return ThreadpoolController().select(user_api="blas")


@contextmanager
def reproducible() -> Iterator[None]:
    """Have BLAS use one thread inside: the last digits of a certificate must not depend on the number of cores.

    Many small products on several threads also take many times as long as on one.
    """
    _one_thread.enter()
    try:
        yield
    finally:
        _one_thread.leave()


@contextmanager
def interruptible(directory: Path, console: Console) -> Iterator[None]:
    """Turn a signal that stopped the campaign into an interrupt, after a line on how to continue.

    Raises:
        KeyboardInterrupt: SIGINT came.
        SystemExit: SIGTERM or SIGHUP came.

    """
    main = threading.current_thread() is threading.main_thread()
    before = [(number, signal.getsignal(number)) for number in stop_signals() if main]
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
