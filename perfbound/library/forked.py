"""Workers of a function that no other process can import: children forked from this process, joined by pipes.

Neither side uses Zenoh, so that a process in which it was opened before may fork: a child never calls it. The messages
and their readers are those of the protocol.
"""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from typing import Any

from ..orchestrator.fleet.children.processes import ChildProcess, Fleet
from ..orchestrator.fleet.link.transport import Garbage, Heartbeat, Inbound, Result, Sink, Token, Transport
from ..schemas.errors import MessageError
from ..schemas.link.messages import (
    MAX_MESSAGE,
    MAX_RESULT,
    Request,
    ResultHeader,
    WorkerState,
    decode_header,
    decode_request,
    decode_state,
    encode_message,
)
from ..schemas.system import SystemSpec
from ..workers.guardian import become_guarded
from ..workers.systems.base import SystemUnderTest
from ..workers.systems.declared import WithSpec

STATE, RESULT = b"state ", b"result "
"""First bytes of a message of a worker."""
ENDED = (EOFError, OSError)
"""What a pipe raises when its other end is gone."""


class Forked:
    """A system of this process, with one worker that is forked from it; `spec` says that no other process has it."""

    def __init__(self, system: SystemUnderTest, spec: SystemSpec) -> None:
        self.spec = spec
        self._system = WithSpec(system, code=spec.code, repeated=spec.repeated)
        self._pipes = PipeTransport()

    @contextmanager
    def transport(self) -> Iterator[Transport]:
        """Open the way to the worker."""
        yield self._pipes

    def fleet(self) -> Fleet:
        """Return the worker, not started yet."""
        return _ForkedFleet(self._system, self._pipes)


class PipeTransport:
    """The orchestrator's port over pipes; each is read by a thread of its own."""

    endpoint = "a pipe of this process"

    def __init__(self) -> None:
        self._sink: Sink | None = None
        self._pipes: dict[str, Connection[Any, Any]] = {}

    def start(self, run: str, sink: Sink) -> None:  # noqa: ARG002  (these workers serve one run alone)
        """Begin to deliver messages to `sink`."""
        self._sink = sink
        for name, pipe in self._pipes.items():
            self._begin(name, pipe, sink)

    def join(self, name: str, pipe: "Connection[Any, Any]") -> None:
        """Add a worker."""
        self._pipes[name] = pipe
        if self._sink is not None:
            self._begin(name, pipe, self._sink)

    def send(self, worker: str, message: Request) -> None:
        """Send a request; a worker that is gone gets none, and its token has disappeared."""
        with contextlib.suppress(*ENDED, KeyError):
            self._pipes[worker].send_bytes(encode_message(message))

    def _begin(self, name: str, pipe: "Connection[Any, Any]", sink: Sink) -> None:
        sink(Token(time.monotonic(), name, alive=True))
        threading.Thread(target=self._pump, args=(name, pipe, sink), daemon=True).start()

    def _pump(self, name: str, pipe: "Connection[Any, Any]", sink: Sink) -> None:
        with pipe, contextlib.suppress(*ENDED):
            while True:
                head = pipe.recv_bytes(MAX_MESSAGE)
                payload = pipe.recv_bytes(MAX_RESULT)
                sink(_inbound(name, head, payload))
        sink(Token(time.monotonic(), name, alive=False))


def _inbound(name: str, head: bytes, payload: bytes) -> Inbound:
    """Return a message of a worker: a heartbeat has no payload, a result has a header in its place."""
    at = time.monotonic()
    try:
        if head.startswith(STATE):
            return Heartbeat(at, name, decode_state(head.removeprefix(STATE)))
        return Result(at, name, decode_header(head.removeprefix(RESULT)), payload)
    except MessageError as error:
        return Garbage(at, name, str(error))


class _ForkedFleet(Fleet):
    """One worker, replaced by another fork when it dies or hangs."""

    def __init__(self, system: SystemUnderTest, pipes: PipeTransport) -> None:
        super().__init__(1, (), "")
        self._system, self._pipes = system, pipes

    def _started(self, worker: str) -> ChildProcess:
        ours, theirs = multiprocessing.Pipe()
        # Forked: pickled, a function would take along what it refers to by guess, and meet other versions of that.
        child = multiprocessing.get_context("fork").Process(
            target=_serve_pipe, args=(worker, theirs, self._system, self._left), daemon=True
        )
        with warnings.catch_warnings():
            # Since Python 3.12 of every fork beside threads: a notebook has some, and the child calls none of theirs.
            warnings.simplefilter("ignore", DeprecationWarning)
            child.start()
        theirs.close()
        self._pipes.join(worker, ours)
        return _ForkedChild(child)


class _ForkedChild:
    """A forked process with the methods of `subprocess.Popen`."""

    def __init__(self, process: ForkProcess) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        return self._process.pid or 0

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0.0)
        return self._process.exitcode

    def terminate(self) -> None:
        self._process.terminate()

    def kill(self) -> None:
        self._process.kill()


# The child


class _PipeUplink:
    """The worker's port over a pipe; heartbeats and results come from two threads."""

    def __init__(self, pipe: "Connection[Any, Any]") -> None:
        self._pipe, self._lock = pipe, threading.Lock()

    def orchestrators(self) -> list[tuple[str, str]]:
        return []

    def join(self, run: str, worker: str, receive: object) -> None:
        """Do nothing: the pipe is there from the start."""

    def leave(self) -> None:
        """Do nothing: the end of the process ends the pipe."""

    def report(self, state: WorkerState) -> None:
        self._send(STATE + encode_message(state), b"")

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        self._send(RESULT + encode_message(header), payload)

    def _send(self, head: bytes, payload: bytes) -> None:
        with self._lock, contextlib.suppress(*ENDED):
            self._pipe.send_bytes(head)
            self._pipe.send_bytes(payload)


def _serve_pipe(name: str, pipe: "Connection[Any, Any]", system: SystemUnderTest, left: int) -> None:
    """Simulate what comes through the pipe, until it ends; the whole life of a child."""
    os.setsid()  # Ctrl-C in the terminal is for the orchestrator, which then ends its workers
    become_guarded(left=left)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # What the function prints must not mix with the output of this process, or of its notebook.
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    from ..workers import systems  # noqa: PLC0415
    from ..workers.worker import WorkerProcess  # noqa: PLC0415

    systems.add(system)
    worker = WorkerProcess(name, _PipeUplink(pipe))

    def receive() -> None:
        with contextlib.suppress(*ENDED):
            while True:
                worker.receive(decode_request(pipe.recv_bytes(MAX_MESSAGE)))
        os._exit(0)  # also in the middle of a rollout: nobody waits for it

    threading.Thread(target=receive, daemon=True).start()
    worker.serve(lambda _outbox_empty: False)
