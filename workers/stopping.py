"""SIGTERM of a worker: it takes nothing more, and its rollout under way is finished or handed back in time.

The handler of Python runs in the main thread, which may be inside a long call of a simulator. What the interpreter does
when the signal arrives is to write a byte to a pipe; a thread of its own waits for that. No signal is blocked, so that
programs which a system starts inherit nothing. Native code that keeps the lock of Python holds up that thread as well:
such a worker ends by a second SIGTERM, or by SIGKILL, and is lost for its orchestrator.
"""

import ctypes
import os
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

import click

from ..schemas.stop_signals import stop_signals
from .ends import DELIVERY

if TYPE_CHECKING:
    from .worker import WorkerProcess

STOPPED = 128 + signal.SIGTERM
"""Exit code after SIGTERM, also where everything was delivered: the campaign is not finished."""
PERIOD = 0.05


class Stopping:
    """The end of this process that SIGTERM asks for; `end_programs` ends those that a system has started."""

    def __init__(self, within: float, end_programs: Callable[[], None]) -> None:
        self._within, self._end_programs = within, end_programs
        self._asked = threading.Event()
        self._numbers = [number for number in stop_signals() if number != signal.SIGINT]
        self._worker: WorkerProcess | None = None

    @property
    def asked(self) -> bool:
        """Whether the signal has arrived."""
        return self._asked.is_set()

    def watch(self) -> None:
        """Take SIGTERM and SIGHUP from now on; in the main thread."""
        read, write = os.pipe()
        os.set_blocking(write, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        for number in self._numbers:
            signal.signal(number, self._begin)
            _only_once(number)
        threading.Thread(target=self._wait, args=(read,), name="stopping", daemon=True).start()

    def attend(self, worker: "WorkerProcess") -> None:
        """Let the signal reach `worker`, also if it has arrived already."""
        self._worker = worker
        if self.asked:
            worker.leave(by_signal=True)

    def _begin(self, number: int, _frame: FrameType | None) -> None:
        """Have a second signal end the programs as well, where the main thread comes to it."""
        signal.signal(number, lambda _number, _frame: self._exit())

    def _wait(self, pipe: int) -> None:
        while os.read(pipe, 1)[0] not in self._numbers:  # SIGINT is an exception of the main thread
            pass
        deadline = time.monotonic() + self._within
        self._asked.set()
        line = f"what is under way has {self._within:g} s to end; a second SIGTERM ends this worker at once"
        click.echo(f"perfbound-worker: {line}", err=True)
        if self._worker is not None:
            self._worker.leave(by_signal=True)
        self._sleep_until(deadline)
        if self._worker is not None and (rollout := self._worker.hand_back()) is not None:
            click.echo(f"perfbound-worker: {rollout} is handed back", err=True)
        self._sleep_until(time.monotonic() + DELIVERY)
        self._exit()

    def _sleep_until(self, deadline: float) -> None:
        """Wait, and end the process early when nothing is left to do; usually the main thread does that before."""
        while time.monotonic() < deadline:
            if self._worker is not None and self._worker.has_left:
                time.sleep(1.0)  # for the main thread, which closes the link
                self._exit()
            time.sleep(PERIOD)

    def _exit(self) -> NoReturn:
        self._end_programs()
        os._exit(STOPPED)


def _only_once(number: int) -> None:
    """Have the kernel end this process at the second signal, whatever it does then.

    The handler of Python's interpreter is installed again, in the manner of System V: its first call resets it.
    """
    libc = ctypes.CDLL(None)
    for function in (libc.signal, libc.sysv_signal):
        function.argtypes, function.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    handler = libc.signal(number, None)
    libc.sysv_signal(number, handler)
