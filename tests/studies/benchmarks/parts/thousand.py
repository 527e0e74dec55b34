"""A thousand workers of one real orchestrator behind a router: where the first limit is.

Orchestrator and router are processes of their own. The workers are real ones but for their sessions: in each of a few
processes hundreds of them share one Zenoh session, since a thousand processes do not fit on one machine. Each has its
name, token, seals, heartbeats and outbox. Their rollouts wait for a while instead of computing, then have a file of the
size of a Segway's.

python -m tests.studies.benchmarks.parts.thousand                       prints the table (ten minutes)
python -m tests.studies.benchmarks.parts.thousand ENDPOINT COUNT FILE   is COUNT workers of the system in FILE
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import zenoh

from perfbound.schemas.errors import MessageError
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.configuration import connect_config
from perfbound.schemas.link.ends import Packet, WorkerEnd
from perfbound.schemas.link.messages import ResultHeader, WorkerState
from perfbound.workers.systems import add_file
from perfbound.workers.transport import Receiver
from perfbound.workers.worker import WorkerProcess
from tests.end_to_end.processes import query
from tests.fakes.puppets import scratch
from tests.sharing import free_port
from tests.studies.benchmarks.report import Row

WORKERS = 1000
PROCESSES = 4
PACES = (20.0, 10.0, 5.0, 2.5)
"""Seconds of a rollout: with 1,000 workers 50 to 400 results a second."""
SECONDS = 40.0
"""Of a measurement, after `WARM` rollouts of every worker."""
WARM = 2.0
PATIENCE = 180.0
SECRET = "a secret of the benchmarks"

SYSTEM = """
import time

import numpy as np

import perfbound as pb

NOISE = np.random.default_rng(0).standard_normal((1501, 8))


@pb.system(
    parameters={"a": pb.Parameter(0, 1), "b": pb.Parameter(0, 1)},
    columns={f"c{k}": "1" for k in range(8)},
    step=0.01,
)
def waiting(a, b, *, seed, horizon, pace=1.0):
    time.sleep(pace)
    return tuple(NOISE.T * (1 + 1e-3 * (seed % 1000)))
"""
CAMPAIGN = """
name = "thousand"
seed = 1
horizon = 15.0
specification = "always (c0 >= -10)"
clip = [-1, 10]
composition = "single"
visual = "none"
spot_check = 0
recheck = 0
hung_after = 300
deadline = 600

[system]
python = "waiting.py:waiting"
pace = {pace}

[space]
scenarios = [{starts}]

[[problems]]
name = "robustness"
method = "scenario"
delta = 0.05
alpha = 1e-9
replicates = 8
window = {window}
max_tests = 1000000
"""


@dataclass(frozen=True)
class Load:
    """What was measured at one pace."""

    pace: float
    offered: float
    """Rollouts a second that the workers could end."""
    recorded: float
    orchestrator: float
    """Share of a core."""
    router: float
    workers: float
    memory: float
    """Of the orchestrator, MB."""
    failed: int
    """Attempts without a result."""
    seen: int
    """Workers that had a rollout."""


def main(workers: int = WORKERS) -> list[Row]:
    """Return the rows."""
    rows = []
    for pace in PACES:
        found = _measure(workers, pace)
        sys.stderr.write(f"  {found}\n")
        name = f"{workers} workers, rollouts of {pace:g} s"
        rows += [
            Row(f"{name}: recorded", found.recorded, "rollouts/s", "offered", found.offered),
            Row(f"{name}: orchestrator", 100 * found.orchestrator, "% of a core"),
            Row(f"{name}: router", 100 * found.router, "% of a core"),
            Row(f"{name}: attempts without a result", found.failed, "attempts"),
            Row(f"{name}: memory of the orchestrator", found.memory, "MB"),
        ]
    return rows


def _measure(workers: int, pace: float) -> Load:
    with scratch() as base, ExitStack() as stack:
        folder = Path(base).absolute()
        (folder / "waiting.py").write_text(SYSTEM)
        starts = ", ".join(f"[{(k % 5) / 5}, {(k // 5) / 5}]" for k in range(25))
        campaign = CAMPAIGN.format(pace=pace, starts=starts, window=max(1, 2 * workers // 8))
        (folder / "thousand.toml").write_text(campaign)
        endpoint, run = f"tcp/127.0.0.1:{free_port()}", folder / "run"
        perfbound = (sys.executable, "-m", "perfbound.orchestrator")
        router = stack.enter_context(_process(folder, *perfbound, "router", "--listen", endpoint))
        orchestrate = (
            *perfbound,
            "orchestrate",
            str(folder / "thousand.toml"),
            "--out",
            str(run),
            "--connect",
            endpoint,
        )
        orchestrator = stack.enter_context(_process(folder, *orchestrate))
        puppets = (sys.executable, "-m", "tests.studies.benchmarks.parts.thousand", endpoint, str(workers // PROCESSES))
        crowd = [
            stack.enter_context(_process(Path.cwd(), *puppets, str(folder / "waiting.py"))) for _ in range(PROCESSES)
        ]
        _wait(lambda: _count(run, "SELECT count(DISTINCT worker) FROM attempts") >= workers, orchestrator)
        time.sleep(WARM * pace)
        before, cpu, start = _recorded(run), [_cpu(each) for each in (router, orchestrator, *crowd)], time.monotonic()
        time.sleep(SECONDS)
        wall = time.monotonic() - start
        spent = [(_cpu(each) - then) / wall for each, then in zip((router, orchestrator, *crowd), cpu, strict=True)]
        return Load(
            pace,
            workers / pace,
            (_recorded(run) - before) / wall,
            spent[1],
            spent[0],
            sum(spent[2:]),
            psutil.Process(orchestrator.pid).memory_info().rss / 1e6,
            _count(run, "SELECT count(*) FROM outcomes WHERE outcome <> 'recorded'"),
            _count(run, "SELECT count(DISTINCT worker) FROM attempts"),
        )


def _recorded(run: Path) -> int:
    return _count(run, "SELECT count(*) FROM rollouts")


def _count(run: Path, statement: str) -> int:
    return int(str(query(run, statement)[0][0])) if (run / "campaign.db").exists() else 0


def _wait(done: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        if time.monotonic() > deadline or process.poll() is not None:
            raise TimeoutError("the workers do not come")
        time.sleep(0.5)


def _cpu(process: subprocess.Popen[bytes]) -> float:
    times = psutil.Process(process.pid).cpu_times()
    return float(times.user + times.system)


@contextmanager
def _process(folder: Path, *command: str) -> Iterator[subprocess.Popen[bytes]]:
    environment = {**os.environ, "PERFBOUND_SECRET": SECRET, "PYTHONPATH": str(Path.cwd())}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


# Workers that share a session


class SharedUplink:
    """The way of one worker over the session of many."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.end = WorkerEnd(SECRET.encode())
        self._token: zenoh.LivelinessToken | None = None
        self.receive: Receiver = lambda _: None

    linked = True

    def orchestrators(self) -> list[tuple[str, str]]:
        """Return (orchestrator, run) of those that are alive."""
        return self.end.orchestrators()

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        """Announce the worker; its requests come through the subscriber of all."""
        self.end.join(run, worker)
        self.receive = receive
        self._token = self._session.liveliness().declare_token(key_expressions.live_worker(run, worker))

    def leave(self) -> None:
        """Stay: the process is killed."""

    def report(self, state: WorkerState) -> None:
        """Put a heartbeat."""
        self._put(self.end.state(state))

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Put a result."""
        self._put(self.end.result(header, payload))

    def _put(self, packet: Packet | None) -> None:
        if packet is not None:
            block = zenoh.CongestionControl.BLOCK
            self._session.put(
                packet.key, packet.payload, attachment=packet.attachment, congestion_control=block, express=True
            )


def _be_workers(endpoint: str, count: int, file: str) -> None:
    add_file(f"{file}:waiting")
    threading.stack_size(256 * 1024)
    while True:
        try:
            session = zenoh.open(zenoh.Config.from_json5(connect_config([endpoint], None, SECRET.encode())))
            break
        except zenoh.ZError:
            time.sleep(0.3)
    uplinks = {key_expressions.fresh_id(f"light-{number}"): SharedUplink(session) for number in range(count)}

    def see(sample: zenoh.Sample) -> None:
        for uplink in uplinks.values():
            take = uplink.end.appear if sample.kind == zenoh.SampleKind.PUT else uplink.end.disappear
            take(str(sample.key_expr))

    def hear(sample: zenoh.Sample) -> None:
        if (uplink := uplinks.get(key_expressions.last(str(sample.key_expr)))) is None:
            return
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        try:
            uplink.receive(uplink.end.request(sample.payload.to_bytes(), attachment))
        except MessageError:
            return

    seen = session.liveliness().declare_subscriber(key_expressions.ANY_ORCHESTRATOR, see, history=True)
    while not next(iter(uplinks.values())).orchestrators():
        time.sleep(0.05)
    run = next(iter(uplinks.values())).orchestrators()[0][1]
    heard = [session.declare_subscriber(key_expressions.request_key(run, name), hear) for name in uplinks]
    for name, uplink in uplinks.items():
        worker = WorkerProcess(name, uplink)
        uplink.join(run, name, worker.receive)
        threading.Thread(target=worker.serve, args=(lambda _: False,), daemon=True).start()
        time.sleep(0.002)
    threading.Event().wait()
    del seen, heard


if __name__ == "__main__":
    if sys.argv[1:]:
        _be_workers(sys.argv[1], int(sys.argv[2]), sys.argv[3])
    else:
        from tests.studies.benchmarks import report

        sys.stdout.write(report.table(main()))
