"""The child processes of `check-system`: rollouts in one process, with a limit of time for each of them."""

import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import IO

from pydantic import TypeAdapter, ValidationError

from ....schemas.system_check import ChildRun, Measured, Trial
from ...fleet.children.child import CHILD_TIMEOUT
from ...fleet.children.family import GRACE, STACK_WRITER, end_family, held_signals, place_of_stack, without_stack

POLL = 0.1
"""Seconds between two looks whether a silent child has ended."""
TAIL, HEAD = 64 * 1024, 200
"""Bytes of stderr that are searched, and characters of stdout that are kept."""


def measure_in_children(
    works: Sequence[Sequence[Trial]], options: Sequence[str], *, limit: float, done: Callable[[int], None]
) -> tuple[ChildRun, ...]:
    """Run each of `works` in a child process of its own, all at the same time, and return what was measured.

    `options` name the system for the children. They begin together when all have loaded it. A rollout, with its
    measurement, may take `limit` seconds; then the child and everything that it started is killed. `done` is called
    with the number of the child after each of its rollouts. The children share a temporary directory.
    """
    with (
        tempfile.TemporaryDirectory(prefix="perfbound-check-") as folder,
        ExitStack() as stack,
        held_signals() as release,
    ):
        reading, writing = os.pipe()
        stack.callback(os.close, reading)
        begin = stack.enter_context(os.fdopen(writing, "wb"))
        children: list[_Child] = []
        try:
            for trials in works:
                # Not by a list of all: one that cannot be started must not hide those that were.
                children.append(_Child(trials, options, folder, reading, stack))  # noqa: PERF401
            release()
            while unfinished := [number for number, child in enumerate(children) if not child.finished]:
                for number in unfinished:
                    if not begin.closed and children[number].has_loaded:
                        children[number].since = time.monotonic()  # it waits for the others
                    for _ in range(children[number].advance(limit)):
                        done(number)
                if all(child.has_loaded or child.finished for child in children):
                    begin.close()
        finally:
            for child in children:
                child.end()
        return tuple(child.run(limit) for child in children)


class _Child:
    """A child process that runs `trials`, when the other end of the pipe `begin` is closed."""

    def __init__(
        self, trials: Sequence[Trial], options: Sequence[str], folder: str, begin: int, stack: ExitStack
    ) -> None:
        self._trials = tuple(trials)
        asked, self._printed, self._errors = (stack.enter_context(_temporary()) for _ in range(3))
        asked.write(TypeAdapter(tuple[Trial, ...]).dump_json(self._trials))
        asked.seek(0)
        reading, writing = os.pipe()
        stack.callback(os.close, reading)
        # -P: a module of the current directory must not replace an installed one.
        line = [sys.executable, "-P", *STACK_WRITER, "-m", "perfbound.workers", "measure"]
        try:
            self._process = subprocess.Popen(
                [*line, "--answers", str(writing), "--begin", str(begin), *options],
                stdin=asked,
                stdout=self._printed,
                stderr=self._errors,
                pass_fds=[writing, begin],
                env={**os.environ, "TMPDIR": folder},
                start_new_session=True,
            )
        finally:
            os.close(writing)
        self._answers = _Answers(reading, self._process)
        self._hung = self.finished = False
        self._code: int | None = None
        self.since = time.monotonic()
        """When it began with what it does."""

    @property
    def has_loaded(self) -> bool:
        """Whether it has loaded the system."""
        return bool(self._answers.found)

    def advance(self, limit: float) -> int:
        """Wait a moment for its next answers, and return the number of the rollouts that it has run since."""
        before = len(self._answers.found)
        more = self._answers.more()
        if more:
            self.since = time.monotonic()
        elif more is None:
            self._hung = time.monotonic() - self.since > self._answer_limit(limit)
        whole = len(self._answers.found) > len(self._trials)
        if whole or self._hung or more is False:
            self.finished = True
            # A thread that still runs may keep one that is whole from ending.
            self._code = None if self._hung or whole else _exit_code(self._process)
        return len(self._answers.found) - max(before, 1)

    def end(self) -> None:
        """End it, everything that it started and everything in its session; one that runs writes where it is."""
        end_family(self._process, stack=True)
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def run(self, limit: float) -> ChildRun:
        """Return what was measured."""
        found, count = self._answers.found, len(self._trials)
        whole, tail = len(found) > count, _tail(self._errors)
        return ChildRun(
            trials=self._trials,
            loaded=next(iter(found), None),
            measured=tuple(found[1 : count + 1]),
            ended="" if whole else _how(self._code, hung=self._hung, limit=self._answer_limit(limit)),
            hung=self._hung,
            place="" if whole else place_of_stack(tail),
            stderr="" if whole else _last_line(tail),
            printed=_head(self._printed),
        )

    def _answer_limit(self, limit: float) -> float:
        """Return the seconds for the next answer: to load a simulator may take longer than a rollout."""
        return limit if self.has_loaded else max(limit, CHILD_TIMEOUT)


class _Answers:
    """The lines of a child so far; a child that ends without closing its pipe has no further ones."""

    def __init__(self, descriptor: int, process: subprocess.Popen[bytes]) -> None:
        self.found: list[Measured] = []
        self._descriptor, self._process, self._rest = descriptor, process, b""
        self._selector = selectors.DefaultSelector()
        self._selector.register(descriptor, selectors.EVENT_READ)

    def more(self) -> bool | None:
        """Return whether there are further lines; None where there are none yet, False where none come."""
        ended = self._process.poll() is not None  # asked before the pipe: what it wrote before its end counts
        if not self._selector.select(0 if ended else POLL):
            return False if ended else None
        if not (data := os.read(self._descriptor, 1 << 16)):
            return False
        *lines, self._rest = (self._rest + data).split(b"\n")
        try:
            self.found += [Measured.model_validate_json(line) for line in lines]
        except ValidationError:
            return False  # code of the system wrote into the pipe
        return True if lines else None


def _temporary() -> IO[bytes]:
    return tempfile.TemporaryFile()


def _exit_code(process: subprocess.Popen[bytes]) -> int | None:
    with suppress(subprocess.TimeoutExpired):
        return process.wait(GRACE)
    return None


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
