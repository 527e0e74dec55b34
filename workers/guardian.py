"""The guardian of a local worker: the process above it, which ends all that its rollouts leave behind.

What a system starts may outlive its rollout, its parent and the worker, also one that is killed or crashes. The kernel
gives all of it to the guardian, which runs no code of a system: nothing holds it up, and it takes no exit code that
a system waits for. It ends as its worker did.
"""

import os
import resource
import selectors
import signal
import time
from contextlib import suppress
from typing import NoReturn

from ..schemas.descendants import descendants
from ..schemas.stop_signals import END_FAMILY
from .lifeline import adopt_orphans, die_with_parent, signal_with_parent

GRACE = 0.5
"""Seconds in which what the worker has left may end by itself."""
TICK = 0.02
HANDED_ON = (signal.SIGTERM, signal.SIGABRT, END_FAMILY)
"""SIGABRT has a worker write where it is."""
FOR_THE_ORCHESTRATOR = (signal.SIGINT, signal.SIGHUP)


def become_guarded(lifeline: int | None = None, left: int | None = None) -> None:
    """Go on in a child process, whose guardian this one becomes: it returns in the child alone.

    At the end of the pipe `lifeline`, or of the process that started this one, the guardian ends the child. Into the
    pipe `left` it writes how many processes it had to end, as a line.
    """
    above, here = os.getppid(), os.getpid()
    # Until each of the two has its handlers: a guardian that a signal ends before would leave what its worker started.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*HANDED_ON, *FOR_THE_ORCHESTRATOR})
    # Not control groups, which are not everywhere a user's right.
    adopt_orphans()
    # Before anything of a system is loaded: the guardian costs 5 MB, and no time of a rollout.
    child = os.fork()
    if child:
        _guard(child, left, lifeline, above, before)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    die_with_parent()
    if os.getppid() != here:
        os._exit(1)


def _guard(child: int, left: int | None, lifeline: int | None, above: int, mask: set[signal.Signals | int]) -> NoReturn:
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    for number in (*HANDED_ON, signal.SIGCHLD):
        signal.signal(number, lambda _number, _frame: None)
    for ignored in FOR_THE_ORCHESTRATOR:
        signal.signal(ignored, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    signal_with_parent(END_FAMILY)
    if os.getppid() != above:
        os.kill(child, signal.SIGKILL)
    _wait(child, read, lifeline)
    _, status = os.waitpid(child, 0)
    number_left = _end_below()
    if number_left and left is not None:
        with suppress(OSError):  # nobody reads any more
            os.write(left, b"%d\n" % number_left)
    _end_as(status)


def _wait(child: int, signals: int, lifeline: int | None) -> None:
    """Hand signals on, and reap what was adopted, until the worker has ended."""
    with selectors.DefaultSelector() as selector:
        for descriptor in (signals, *([] if lifeline is None else [lifeline])):
            selector.register(descriptor, selectors.EVENT_READ)
        while not _has_ended(child):
            for key, _ in selector.select():
                if key.fd == signals:
                    for number in os.read(signals, 100):
                        if number != signal.SIGCHLD:
                            os.kill(child, signal.SIGKILL if number == END_FAMILY else number)
                elif not os.read(key.fd, 1):
                    os.kill(child, signal.SIGKILL)
                    selector.unregister(key.fd)


def _has_ended(child: int) -> bool:
    """Whether the worker has ended; it is not reaped: its number stays its own while it may get a signal."""
    while (found := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
        if found.si_pid == child:
            return True
        os.waitpid(found.si_pid, 0)
    return False


def _end_below() -> int:
    """End every process below this one; return how many did not end by themselves."""
    ended: set[int] = set()
    deadline = time.monotonic() + GRACE
    while True:
        _reap()
        if not (below := descendants(os.getpid())):
            return len(ended)
        if time.monotonic() >= deadline:
            for pid in below:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            ended.update(below)
        time.sleep(TICK)


def _reap() -> None:
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _end_as(status: int) -> NoReturn:
    """End with the exit code or by the signal of the worker."""
    if os.WIFSIGNALED(status):
        # The core of the guardian itself would say nothing of the worker.
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        number = os.WTERMSIG(status)
        if number != signal.SIGKILL:
            signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
    os._exit(os.waitstatus_to_exitcode(status))
