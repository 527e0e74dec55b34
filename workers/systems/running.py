"""A program that is running: a line to its stdin, a line from its stdout, its stderr for the reason of a failure."""

import atexit
import contextlib
import os
import resource
import selectors
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from ...schemas.errors import SimulationError
from .place import leave

LAUNCH = Path(__file__).with_name("launch.py")
TICK = 0.1
"""Seconds between two calls of `waiting`."""
MAX_ANSWER = 65_536
KEPT = 4_000
"""Bytes of stderr that are kept."""
TOLD = 3
"""Lines of stderr in the reason of a failure."""
PIECE = 65_536


class EndedError(SimulationError):
    """The program ended without an answer; `quietly` with exit code 0."""

    def __init__(self, reason: str, *, quietly: bool) -> None:
        super().__init__(reason)
        self.quietly = quietly


@dataclass(frozen=True, slots=True)
class Command:
    """A program with its arguments, and its limits: bytes of memory, and CPU seconds between two answers."""

    name: str
    """In messages."""
    line: tuple[str, ...]
    memory: int
    cpu: float | None = None


_ALL: "set[RunningProgram]" = set()


@atexit.register
def end_all() -> None:
    """End every program of this process, with what it has started."""
    for each in list(_ALL):
        each.kill()


def pids() -> list[int]:
    """Return the process ids of the programs of this process."""
    return [each.pid for each in _ALL]


def _terminated(number: int, _frame: FrameType | None) -> None:
    end_all()
    leave()
    os._exit(128 + number)


class RunningProgram:
    """A process group of its own, which `kill` ends as a whole."""

    def __init__(self, command: Command, folder: Path, environment: Mapping[str, str]) -> None:
        self._name, self._cpu = command.name, command.cpu
        self._child = subprocess.Popen(
            # -I, -S: of Python itself alone, so that the start takes 10 ms.
            [sys.executable, "-I", "-S", str(LAUNCH), str(command.memory), str(os.getpid()), *command.line],
            cwd=folder,
            env=dict(environment),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
        )
        _ALL.add(self)
        # Of a worker that is asked to end: not by an exception, which a rollout would take for a failure of its own.
        if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminated)
        self._answer, self._errors = b"", b""
        self._selector = selectors.DefaultSelector()
        for pipe in (self._child.stdout, self._child.stderr):
            assert pipe is not None, "both are pipes"
            os.set_blocking(pipe.fileno(), False)
            self._selector.register(pipe.fileno(), selectors.EVENT_READ, pipe is self._child.stderr)

    @property
    def pid(self) -> int:
        """Process id of the program, and of its process group."""
        return self._child.pid

    def ask(self, line: bytes, waiting: Callable[[], None]) -> bytes:
        """Send a line and return the answer without its end; `waiting` is called ten times a second and may raise.

        Raises:
            EndedError: the program ended first.
            SimulationError: it writes something else than one line.

        """
        self._limit_cpu()
        assert self._child.stdin is not None, "it is a pipe"
        try:
            self._child.stdin.write(line + b"\n")
        except BrokenPipeError:
            raise self._ended() from None
        while b"\n" not in self._answer:
            # A process that it has started may keep its stdout open.
            over = not self._read(TICK) or self._exit_code() is not None
            if len(self._answer) > MAX_ANSWER:
                raise SimulationError(f"{self._name} wrote more than {MAX_ANSWER} bytes to its stdout in one line")
            if over:
                self._read(0)
                if b"\n" not in self._answer:
                    raise self._ended()
            waiting()
        answer, _, self._answer = self._answer.partition(b"\n")
        return answer

    @property
    def unasked(self) -> bytes:
        """What the program wrote after its answer."""
        self._read(0)
        return self._answer

    @property
    def last_errors(self) -> str:
        """The last lines of stderr, in one."""
        lines = [line for line in self._errors.decode(errors="backslashreplace").splitlines() if line.strip()]
        return " | ".join(line.strip() for line in lines[-TOLD:])

    def kill(self) -> None:
        """End the whole process group; a second time it does nothing."""
        if self not in _ALL:
            return
        _ALL.discard(self)
        # The group before the program is waited for: until then no other group can have its number.
        with contextlib.suppress(ProcessLookupError):  # ended, with everything that it started
            os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()
        self._selector.close()
        for pipe in (self._child.stdin, self._child.stdout, self._child.stderr):
            if pipe is not None:
                pipe.close()

    def _read(self, seconds: float) -> bool:
        """Take what was written within some seconds; return False at the end of stdout."""
        is_open = True
        for key, _ in self._selector.select(seconds):
            data = os.read(key.fd, PIECE)
            if key.data:
                self._errors = (self._errors + data)[-KEPT:]
            else:
                self._answer += data
            if not data:
                self._selector.unregister(key.fd)
                is_open = is_open and bool(key.data)
        return is_open

    def _ended(self) -> EndedError:
        """Return how the program ended; it gets a second for its last words and its exit code."""
        for _ in range(20):
            self._read(TICK / 2)
            if (code := self._exit_code()) is not None:
                break
        else:
            return EndedError(f"{self._name} closed its stdout without an answer{self._told()}", quietly=False)
        if code >= 0:
            return EndedError(
                f"{self._name} ended with exit code {code} and no answer{self._told()}", quietly=code == 0
            )
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        hint = " (more CPU time than limits.cpu)" if -code == signal.SIGXCPU else ""
        return EndedError(f"{self._name} was ended by {name}{hint}{self._told()}", quietly=False)

    def _exit_code(self) -> int | None:
        """Return the exit code, or minus the signal, of a program that has ended; it stays a child until `kill`."""
        found = os.waitid(os.P_PID, self._child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if found is None:
            return None
        return found.si_status if found.si_code == os.CLD_EXITED else -found.si_status

    def _told(self) -> str:
        return f"; its last words: {self.last_errors}" if self.last_errors else ""

    def _limit_cpu(self) -> None:
        """Let the program use some more CPU seconds than it has used until now."""
        if self._cpu is None:
            return
        fields = Path(f"/proc/{self._child.pid}/stat").read_text().rpartition(")")[2].split()
        used = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        hard = resource.prlimit(self._child.pid, resource.RLIMIT_CPU)[1]
        resource.prlimit(self._child.pid, resource.RLIMIT_CPU, (int(used + self._cpu) + 1, hard))
