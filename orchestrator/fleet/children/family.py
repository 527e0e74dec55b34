"""The end of a child process with everything that it started, and the place in the user's code where it was."""

import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from ....schemas.descendants import descendants
from ....schemas.places import own_place
from ....schemas.stop_signals import stop_signals

GRACE = 5.0
"""Seconds in which a child that hangs may write where it hangs."""
STACK_WRITER = ("-X", "faulthandler")
"""Arguments of a Python that writes its stack to stderr when `end_family` ends it."""
_STACK = re.compile(r"^(?:Current thread|Thread) .*?(?=^$|\Z|^Thread |^Current thread )", re.MULTILINE | re.DOTALL)
_FRAME = re.compile(r'^  File "(.+)", line (\d+) in', re.MULTILINE)
"""A line of Python's fault handler; the innermost frame comes first."""


@contextmanager
def held_signals() -> Iterator[Callable[[], None]]:
    """Hold the signals that end a command back until the function that this yields is called, or the block ends.

    A handler that raises while a child starts would leave a child that nobody knows, and so nobody ends.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None  # only the main thread runs handlers
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda number, _frame: came.append(number)) for number in stop_signals()}

    def release() -> None:
        while before:
            signal.signal(*before.popitem())
        if came:
            signal.raise_signal(came.pop())

    try:
        yield release
    finally:
        release()


def end_family(process: "subprocess.Popen[bytes] | subprocess.Popen[str]", *, stack: bool = False) -> None:
    """End a child and everything that it started; with `stack` it writes where it is, if it has `STACK_WRITER`."""
    # Before the kill: without their parent nothing distinguishes them from other processes.
    started = descendants(process.pid) if process.returncode is None else []
    if stack and process.poll() is None:
        process.send_signal(signal.SIGABRT)
        with suppress(subprocess.TimeoutExpired):
            process.wait(GRACE)
    process.kill()
    for pid in started:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    process.wait()


def place_of_stack(text: str) -> str:
    """Return file and line of the user's code from what the fault handler wrote; empty if there is none.

    >>> place_of_stack('Current thread 0x7f (most recent call first):\\n  File "/me/cars.py", line 7 in cars\\n')
    '/me/cars.py, line 7'
    """
    stacks = _STACK.findall(text)
    # Of several threads the one that got the signal, which runs the rollout.
    chosen = next((each for each in stacks if each.startswith("Current")), text)
    return own_place([(file, int(number)) for file, number in reversed(_FRAME.findall(chosen))])


def without_stack(text: str) -> str:
    """Return what a process wrote before its fault handler."""
    return text.partition("Fatal Python error")[0]
