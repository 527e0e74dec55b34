"""Local workers: child processes that end with the orchestrator, and are replaced when they die or hang."""

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from ....schemas.errors import PerfboundError
from ....schemas.link import key_expressions
from ....schemas.stop_signals import END_FAMILY

GRACE = 1.0
"""Seconds between asking a worker to end and killing it."""
FAMILY = 3.0
"""Seconds in which what a worker has left ends, see `workers.guardian`."""
PIPE = 65536
"""Bytes of the numbers of processes that were left; a line for each worker that left some."""
FAST_DEATHS = 5
"""Times in a row that workers may die within `FAST` seconds of their start: then none can run on this machine.

Those that die between two looks count once: something that kills all of them at once says nothing of the next ones.
"""
FAST = 3.0


class ChildProcess(Protocol):
    """What a fleet needs of a process, as `subprocess.Popen` has it."""

    @property
    def pid(self) -> int:
        """Process id."""
        ...

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while it runs."""
        ...

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; raises `subprocess.TimeoutExpired`."""
        ...

    def terminate(self) -> None:
        """Ask it to end."""
        ...

    def kill(self) -> None:
        """End it."""
        ...


@dataclass
class _Child:
    worker: str
    process: ChildProcess
    started: float
    killed: bool = False


class Fleet:
    """`size` local workers of one run; `environment` is added to that of this process."""

    def __init__(
        self,
        size: int,
        endpoints: Sequence[str],
        run: str,
        options: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        ways = [part for endpoint in endpoints for part in ("--connect", endpoint)]
        self._arguments = [*ways, "--run", run, *options]
        self._environment = environment or {}
        self._size = size
        self._next = 0
        self._fast_deaths = 0
        self._children: list[_Child] = []
        self.ended: dict[str, str] = {}
        """How the workers of these names have ended by themselves."""
        # Only this process holds the writing end, so that kill -9 of it ends the pipe of every worker.
        self._lifeline, self._our_end = os.pipe()
        self._reports, self._left = os.pipe()
        self.left = 0
        """Processes that rollouts had started and that were there after their worker, and were ended; after `stop`."""

    def start(self) -> None:
        """Start all workers."""
        while len(self._children) < self._size:
            self._spawn()

    def tend(self) -> list[str]:
        """Replace workers that have ended; return a line for each.

        Raises:
            PerfboundError: they end as fast as they are started.

        """
        news = []
        gone = [(child, code) for child in self._children if (code := child.process.poll()) is not None]
        by_themselves = [child for child, _ in gone if not child.killed]  # by us, which says nothing of what can run
        if by_themselves:
            fast = all(time.monotonic() - child.started < FAST for child in by_themselves)
            self._fast_deaths = self._fast_deaths + 1 if fast else 0
        for child, code in gone:
            self._children.remove(child)
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            if not child.killed:
                self.ended[child.worker] = how
            if self._fast_deaths >= FAST_DEATHS:
                raise PerfboundError(
                    f"local workers ended within {FAST:g} s of their start, {FAST_DEATHS} times in a row "
                    f"(last: {how}); run `perfbound systems` and `perfbound simulate` to find the cause"
                )
            self._spawn()
            what = "replaced" if child.killed else f"ended ({how})"
            news.append(f"local worker {child.worker} {what}; started {self._children[-1].worker}")
        return news

    def kill(self, worker: str) -> bool:
        """Kill a local worker, which `tend` replaces; return whether `worker` is one of them.

        Workers are known by the name that they were started with, never by a number or host that a message claims.
        """
        found = [child for child in self._children if child.worker == worker]
        for child in found:
            child.killed = True
            _end_now(child.process)
        return bool(found)

    def replaces(self, worker: str) -> bool:
        """Whether `worker` is a local one, which another process replaces when it ends."""
        return worker in self.ended or any(child.worker == worker for child in self._children)

    def stop(self) -> None:
        """End all workers and what their rollouts have left, and wait for them."""
        for child in self._children:
            # All of them before any is waited for, so that they end side by side.
            child.process.terminate()
        self._wait(GRACE)
        for child in self._children:
            _end_now(child.process)
        self._wait(FAMILY)
        for child in self._children:
            child.process.kill()
            child.process.wait()
        self._children.clear()
        for descriptor in (self._our_end, self._lifeline, self._left):
            os.close(descriptor)
        os.set_blocking(self._reports, False)  # a process of the user may have a copy of the other end
        with suppress(BlockingIOError):
            self.left += sum(map(int, os.read(self._reports, PIPE).split()))
        os.close(self._reports)

    def _wait(self, seconds: float) -> None:
        """Wait for the end of the workers, at most so long."""
        deadline = time.monotonic() + seconds
        for child in self._children:
            with suppress(subprocess.TimeoutExpired):
                child.process.wait(max(0.0, deadline - time.monotonic()))

    def _spawn(self) -> None:
        self._next += 1
        worker = key_expressions.fresh_id(f"local-{self._next}")
        self._children.append(_Child(worker, self._started(worker), time.monotonic()))

    def _started(self, worker: str) -> ChildProcess:
        """Start one worker under its name."""
        return subprocess.Popen(
            [
                # -P: a module of the current directory must not replace an installed one.
                *(sys.executable, "-P", "-m", "perfbound.workers", f"--guarded={self._lifeline},{self._left}"),
                *("serve", *self._arguments, "--as", worker),
            ],
            env={**os.environ, **self._environment},
            pass_fds=[self._lifeline, self._left],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            # A session of its own: Ctrl-C in the terminal is for the orchestrator, which then ends its workers.
            start_new_session=True,
        )


def _end_now(process: ChildProcess) -> None:
    if process.poll() is None:  # else its number may be another's
        os.kill(process.pid, END_FAMILY)
