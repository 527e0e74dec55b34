"""Signs of life of a function that reports no progress of its own: if it hangs, the deadline ends its attempt."""

import _thread
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from .base import Progress

TICK = 1.0
"""Seconds between two signs."""


@contextmanager
def signs_of_life(progress: Progress) -> Iterator[None]:
    """Report progress about once a second, and not after the end of the block."""
    clock = _clock(os.getpid())
    rollout = clock.add(progress)
    try:
        yield
    finally:
        clock.remove(rollout)


class _Rollout:
    def __init__(self, progress: Progress) -> None:
        self.progress, self.step = progress, 0

    def report(self) -> bool:
        """Return whether to continue: a cancelled function cannot be interrupted, and is silent until it returns."""
        self.step += 1
        try:
            self.progress(self.step)
        except Exception:  # noqa: BLE001  (mostly `Cancelled`; none may end the signs of other rollouts)
            return False
        return True


class _Clock:
    """A thread for the rollouts of this process, which ends in the first second without one.

    To start a thread for every rollout would cost more than all else around a fast function: 0.2 ms.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rollouts: list[_Rollout] = []
        self._running = False
        # Never set. Not `time.sleep`, which a system or a test may replace: a clock that ends so would never run again.
        self._pause = threading.Event()

    def add(self, progress: Progress) -> _Rollout:
        rollout = _Rollout(progress)
        with self._lock:
            self._rollouts.append(rollout)
            if not self._running:
                self._running = True
                # Not of `threading`, whose list shows the threads that a system itself leaves behind.
                _thread.start_new_thread(self._run, ())
        return rollout

    def remove(self, rollout: _Rollout) -> None:
        with self._lock:
            if rollout in self._rollouts:
                self._rollouts.remove(rollout)

    def _run(self) -> None:
        while True:
            self._pause.wait(TICK)
            with self._lock:
                if not self._rollouts:
                    self._running = False
                    return
                self._rollouts = [each for each in self._rollouts if each.report()]


@cache
def _clock(_process: int) -> _Clock:
    """Return the clock of a process: in a forked one, the thread of the first does not run."""
    return _Clock()
