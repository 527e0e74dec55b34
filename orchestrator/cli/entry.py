"""The entry point: signals, and one line for a known error."""

import os
import signal
import sys
import threading
import time
from types import FrameType

from ...schemas.errors import PerfboundError, Stopped
from ...schemas.host import host_fault
from ...schemas.platforms import one_blas_thread
from .exits import end, process_end, take_signals
from .group import cli
from .pipes import readers_may_end


def _stop(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code is _unraisable.__code__:
            return  # raised in there it would be lost; it is repeated until it gets through
        frame = frame.f_back
    take_signals(signal.SIG_IGN)  # a second Ctrl-C must not interrupt the shutdown
    raise Stopped(number)


def _unraisable(lost: "sys.UnraisableHookArgs") -> None:
    """Repeat a signal that arrived while a destructor ran: Python drops exceptions there."""
    if isinstance(lost.exc_value, Stopped):
        take_signals(_stop)
        threading.Thread(target=_repeat, args=(lost.exc_value.signal,), daemon=True).start()
    else:
        sys.__unraisablehook__(lost)


def _repeat(number: int) -> None:
    """Send this process a signal, until it is no longer waited for."""
    while True:
        time.sleep(0.02)
        os.kill(os.getpid(), number)
        if signal.getsignal(number) is not _stop:
            return


def main() -> None:
    """`perfbound`: a known error is one line on stderr and exit code 1."""
    sys.unraisablehook = _unraisable
    with process_end(), readers_may_end():
        try:
            try:
                take_signals(_stop)
                _main()
            finally:
                # What is left is to flush and to exit: an exception in there would lose the exit code of a success.
                take_signals(signal.SIG_IGN)
        except Stopped as request:
            end(f"stopped; {request.state}", code=128 + request.signal)


def _main() -> None:
    one_blas_thread()
    try:
        cli(prog_name="perfbound")
    except PerfboundError as error:
        end(*error.lines, code=1)
    except OSError as error:
        end(host_fault(error) or f"{error.filename or 'file system'}: {error.strerror or error}", code=1)
    except Exception as error:
        if (fault := host_fault(error)) is None:
            raise
        end(fault, code=1)
