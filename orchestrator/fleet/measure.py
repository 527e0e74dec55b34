"""The child processes of `check-system`: rollouts in one process, with a limit of time for each of them."""

import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import IO

from pydantic import TypeAdapter, ValidationError

from ...schemas.system_check import ChildRun, Measured, Trial
from .child import CHILD_TIMEOUT
from .family import GRACE, STACK_WRITER, end_family, held_signals, place_of_stack, without_stack

POLL = 0.1
"""Seconds between two looks whether a silent child has ended."""
TAIL, HEAD = 64 * 1024, 200
"""Bytes of stderr that are searched, and characters of stdout that are kept."""


def measure_in_child(
    trials: Sequence[Trial], options: Sequence[str], *, limit: float, done: Callable[[], None]
) -> ChildRun:
    """Run `trials` in one child process, and return what was measured; `done` is called after each of them.

    `options` name the system for the child. A rollout, with its measurement, may take `limit` seconds; then the child
    and everything that it started is killed. The child has a temporary directory of its own.
    """
    with (
        tempfile.TemporaryDirectory(prefix="perfbound-check-") as folder,
        tempfile.TemporaryFile() as asked,
        tempfile.TemporaryFile() as printed,
        tempfile.TemporaryFile() as errors,
        held_signals() as release,
    ):
        asked.write(TypeAdapter(tuple[Trial, ...]).dump_json(tuple(trials)))
        asked.seek(0)
        reading, writing = os.pipe()
        # -P: a module of the current directory must not replace an installed one.
        line = [sys.executable, "-P", *STACK_WRITER, "-m", "perfbound.workers", "measure"]
        process = subprocess.Popen(
            [*line, "--answers", str(writing), *options],
            stdin=asked,
            stdout=printed,
            stderr=errors,
            pass_fds=[writing],
            env={**os.environ, "TMPDIR": folder},
            start_new_session=True,
        )
        try:
            os.close(writing)
            release()
            answers = _Answers(reading, process)
            hung = _collect(answers, len(trials), limit, done)
            whole = len(answers.found) > len(trials)  # a thread that still runs may keep it from ending
            code = None if hung or whole else _exit_code(process)
        finally:
            _end(process)
            os.close(reading)
        loaded, measured = next(iter(answers.found), None), answers.found[1 : len(trials) + 1]
        tail = _tail(errors)
        return ChildRun(
            trials=tuple(trials),
            loaded=loaded,
            measured=tuple(measured),
            ended="" if whole else _how(code, hung=hung, limit=_answer_limit(limit, loaded=loaded is not None)),
            hung=hung,
            place="" if whole else place_of_stack(tail),
            stderr="" if whole else _last_line(tail),
            printed=_head(printed),
        )


class _Answers:
    """The lines of a child so far; a child that ends without closing its pipe has no further ones."""

    def __init__(self, descriptor: int, process: subprocess.Popen[bytes]) -> None:
        self.found: list[Measured] = []
        self._descriptor, self._process, self._rest = descriptor, process, b""
        self._selector = selectors.DefaultSelector()
        self._selector.register(descriptor, selectors.EVENT_READ)

    def more(self, deadline: float) -> bool | None:
        """Wait for the next lines: whether there are some; None after the deadline (of `time.monotonic`)."""
        while True:
            ended = self._process.poll() is not None  # asked before the pipe: what it wrote before its end counts
            if self._selector.select(0 if ended else POLL):
                data = os.read(self._descriptor, 1 << 16)
                if not data:
                    return False
                *lines, self._rest = (self._rest + data).split(b"\n")
                try:
                    self.found += [Measured.model_validate_json(line) for line in lines]
                except ValidationError:
                    return False  # code of the system wrote into the pipe
                if lines:
                    return True
            elif ended:
                return False
            elif time.monotonic() > deadline:
                return None


def _collect(answers: _Answers, trials: int, limit: float, done: Callable[[], None]) -> bool:
    """Collect the answer after loading and that of every trial; return whether the child hangs."""
    while (before := len(answers.found)) <= trials:
        if (more := answers.more(time.monotonic() + _answer_limit(limit, loaded=bool(before)))) is None:
            return True
        if not more:
            return False
        for _ in range(max(before, 1), len(answers.found)):
            done()
    return False


def _answer_limit(limit: float, *, loaded: bool) -> float:
    """Return the seconds for the next answer: to load a simulator may take longer than a rollout."""
    return limit if loaded else max(limit, CHILD_TIMEOUT)


def _exit_code(process: subprocess.Popen[bytes]) -> int | None:
    with suppress(subprocess.TimeoutExpired):
        return process.wait(GRACE)
    return None


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the child, everything that it started and everything in its session; one that runs writes where it is."""
    end_family(process, stack=True)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _how(code: int | None, *, hung: bool, limit: float) -> str:
    if hung:
        return f"gave no answer within {limit:g} s"
    if code is None:
        return "closed the pipe of its measurements, or wrote into it"
    if code < 0:
        return f"ended by signal {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


def _tail(file: IO[bytes]) -> str:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - TAIL))
    return file.read().decode(errors="replace")


def _last_line(text: str) -> str:
    lines = [line.strip() for line in without_stack(text).splitlines() if line.strip()]
    return lines[-1].removeprefix("perfbound-worker: ") if lines else ""


def _head(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read(4 * HEAD).decode(errors="replace").strip().partition("\n")[0][:HEAD]
