"""Many Zenoh sessions of light workers that only send heartbeats: does it hold, and what does a message cost?

python -m tests.studies.benchmarks.parts.sessions ENDPOINT RUN COUNT     is COUNT of these workers
"""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from perfbound.orchestrator.fleet.link.transport import Heartbeat, Inbound, Token, ZenohTransport, listen
from perfbound.schemas import __version__
from perfbound.schemas.link.key_expressions import fresh_id
from perfbound.schemas.link.messages import PROTOCOL, Request, WorkerState
from perfbound.workers.transport import connect
from tests.studies.benchmarks.report import Row

SESSIONS = (10, 50, 200)
PROCESSES = 2
PERIOD = 0.5
"""Seconds between two heartbeats of a worker."""
SECONDS = 10.0
PATIENCE = 120.0
"""Seconds until all must have shown themselves."""


@dataclass
class Heard:
    """Received messages."""

    alive: set[str] = field(default_factory=set)
    beats: Counter[str] = field(default_factory=Counter)
    lost: int = 0
    """Tokens that went away."""

    def take(self, message: Inbound) -> None:
        """Count a message; called by the threads of the transport."""
        if isinstance(message, Token):
            self.lost += not message.alive
            (self.alive.add if message.alive else self.alive.discard)(message.worker)
        elif isinstance(message, Heartbeat):
            self.beats[message.worker] += 1


def main() -> list[Row]:
    """Return the rows by number of sessions."""
    return [row for count in SESSIONS for row in _measure(count)]


def _measure(count: int) -> list[Row]:
    heard, run = Heard(), fresh_id("bench")
    with listen("tcp/127.0.0.1:0") as transport:
        transport.start(run, heard.take)
        start = time.monotonic()
        with _workers(transport, run, count):
            while len(heard.alive) < count and time.monotonic() - start < PATIENCE:
                time.sleep(0.1)
            joined = time.monotonic() - start
            heard.beats.clear()
            wall, cpu = time.monotonic(), time.process_time()
            time.sleep(SECONDS)
            wall, cpu = time.monotonic() - wall, time.process_time() - cpu
            beats, threads, lost = heard.beats.copy(), len(os.listdir("/proc/self/task")), heard.lost
    name, total = f"{count} Zenoh sessions", max(beats.total(), 1)
    expected = wall / PERIOD
    return [
        Row(f"{name}: all alive after", joined, "s wall"),
        Row(f"{name}: heartbeats that arrived", total / wall, "messages/s", "sent at most", count / PERIOD),
        Row(
            f"{name}: of the worker least heard",
            100 * min((beats[each] for each in heard.alive), default=0) / expected,
            "%",
        ),
        Row(f"{name}: tokens lost meanwhile", lost, "tokens"),
        Row(f"{name}: CPU per heartbeat, transport with decoding", 1e6 * cpu / total, "us"),
        Row(f"{name}: threads of the orchestrator", threads, "threads"),
    ]


@contextmanager
def _workers(transport: ZenohTransport, run: str, count: int) -> Iterator[None]:
    command = [
        sys.executable,
        "-m",
        "tests.studies.benchmarks.parts.sessions",
        transport.endpoint,
        run,
        str(count // PROCESSES),
    ]
    started = [subprocess.Popen(command, stdin=subprocess.PIPE, cwd=Path.cwd()) for _ in range(PROCESSES)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def _be_workers(endpoint: str, run: str, count: int) -> None:
    with ExitStack() as stack:
        uplinks = [stack.enter_context(connect([endpoint], None, lambda: None)) for _ in range(count)]
        names = [fresh_id(f"light-{os.getpid()}-{number}") for number in range(count)]
        for uplink, name in zip(uplinks, names, strict=True):
            uplink.join(run, name, _ignore)
        due = time.monotonic()
        while True:
            for uplink, name in zip(uplinks, names, strict=True):
                uplink.report(_idle(name))
            due = max(due + PERIOD, time.monotonic())
            time.sleep(due - time.monotonic())


def _ignore(_: Request) -> None:
    """Do nothing that is asked."""


def _idle(name: str) -> WorkerState:
    return WorkerState(
        protocol=PROTOCOL, version=__version__, worker=name, host="here", pid=1, systems={}, state="idle"
    )


if __name__ == "__main__":
    _be_workers(sys.argv[1], sys.argv[2], int(sys.argv[3]))
