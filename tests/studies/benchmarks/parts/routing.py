"""A router between orchestrator and workers against the direct link: rollouts a second, and the time of one.

The orchestrator's end of the link and 64 workers that answer at once with a file of 100 kB, without the main loop: what
is compared is the way of the messages. The workers are real sessions, in two processes.

python -m tests.studies.benchmarks.parts.routing ENDPOINT RUN COUNT     is COUNT of these workers
"""

import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from perfbound.orchestrator.fleet.link.transport import (
    Inbound,
    Result,
    Token,
    ZenohTransport,
    connect_to_router,
    listen,
)
from perfbound.schemas.link.configuration import LOCAL
from perfbound.schemas.link.key_expressions import fresh_id
from perfbound.schemas.link.messages import Ack, Request, ResultHeader
from perfbound.workers.transport import ZenohUplink, connect
from tests.sharing import free_port
from tests.studies.benchmarks.report import Row

WORKERS = 64
PROCESSES = 2
PAYLOAD = os.urandom(100_000)
SECONDS = 4.0
"""Of each measurement."""
ROUNDS = 3
"""Direct and routed in turn; the best of each counts."""
SECRET = "a secret of the benchmarks"


class Driver:
    """An orchestrator without a loop: a worker gets its next rollout when its result is there."""

    def __init__(self, transport: ZenohTransport) -> None:
        self._transport = transport
        self.alive: set[str] = set()
        self.running = False
        self.results = 0
        self.came = threading.Event()

    def take(self, message: Inbound) -> None:
        """Take a message; called by the threads of the transport."""
        if isinstance(message, Token):
            (self.alive.add if message.alive else self.alive.discard)(message.worker)
        elif isinstance(message, Result):
            self.results += 1
            if self.running:
                self.ask(message.worker)
            self.came.set()

    def ask(self, worker: str) -> None:
        """Ask a worker for a rollout."""
        self._transport.send(worker, Ack(rollout="maximum.0.true.0", attempt=1))

    def throughput(self) -> float:
        """Return the results a second of all workers."""
        self.running = True
        for worker in self.alive:
            self.ask(worker)
        time.sleep(SECONDS / 4)
        before, start = self.results, time.monotonic()
        time.sleep(SECONDS)
        rate = (self.results - before) / (time.monotonic() - start)
        self.running = False
        time.sleep(SECONDS / 4)  # those under way
        return rate

    def latency(self) -> float:
        """Return the median time in s from a request to its result, with one under way at a time."""
        found, end = list[float](), time.monotonic() + SECONDS
        for worker in iter(lambda: next(iter(self.alive)), None):
            if time.monotonic() > end:
                return statistics.median(found)
            self.came.clear()
            start = time.perf_counter()
            self.ask(worker)
            self.came.wait()
            found.append(time.perf_counter() - start)
        raise AssertionError("a worker is always there")


def main() -> list[Row]:
    """Return the rows."""
    direct, routed = list[tuple[float, float]](), list[tuple[float, float]]()
    for _ in range(ROUNDS):
        with listen(LOCAL, secret=SECRET.encode()) as transport:
            direct.append(_measured(transport, transport.endpoint))
        with _router() as endpoint, connect_to_router([endpoint], None, SECRET.encode(), print) as transport:
            routed.append(_measured(transport, endpoint))
    rates = [max(rate for rate, _ in each) for each in (routed, direct)]
    times = [1000 * min(time for _, time in each) for each in (routed, direct)]
    return [
        Row(f"{WORKERS} workers behind a router: results of 100 kB", rates[0], "results/s", "direct link", rates[1]),
        Row(f"{WORKERS} workers behind a router: request to result", times[0], "ms", "direct link", times[1]),
    ]


def _measured(transport: ZenohTransport, endpoint: str) -> tuple[float, float]:
    driver, run = Driver(transport), fresh_id("bench")
    transport.start(run, driver.take)
    with _workers(endpoint, run):
        while len(driver.alive) < WORKERS:
            time.sleep(0.1)
        time.sleep(1.0)
        return driver.throughput(), driver.latency()


@contextmanager
def _router() -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "perfbound.orchestrator", "router", "--listen", endpoint]
    with _process(*command):
        yield endpoint


@contextmanager
def _workers(endpoint: str, run: str) -> Iterator[None]:
    command = [sys.executable, "-m", "tests.studies.benchmarks.parts.routing", endpoint, run, str(WORKERS // PROCESSES)]
    with ExitStack() as stack:
        for _ in range(PROCESSES):
            stack.enter_context(_process(*command))
        yield


@contextmanager
def _process(*command: str) -> Iterator[None]:
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env={**os.environ, "PERFBOUND_SECRET": SECRET})
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _be_workers(endpoint: str, run: str, count: int) -> None:
    with ExitStack() as stack:
        for number in range(count):
            uplink = stack.enter_context(connect([endpoint], None, lambda: None, SECRET.encode()))
            name = fresh_id(f"light-{os.getpid()}-{number}")
            while not uplink.orchestrators():
                time.sleep(0.01)
            uplink.join(run, name, _Answer(uplink, name))
        threading.Event().wait()


class _Answer:
    """What a worker does with a request: it sends a result at once."""

    def __init__(self, uplink: ZenohUplink, name: str) -> None:
        self._uplink, self._name = uplink, name

    def __call__(self, request: Request) -> None:
        assert isinstance(request, Ack)
        header = ResultHeader(
            rollout=request.rollout,
            attempt=request.attempt,
            worker=self._name,
            outcome="done",
            sha256="0" * 64,
            error="",
            cpu_seconds=0.0,
            wall_seconds=0.0,
            proof="0" * 64,
        )
        self._uplink.deliver(header, PAYLOAD)


if __name__ == "__main__":
    _be_workers(sys.argv[1], sys.argv[2], int(sys.argv[3]))
