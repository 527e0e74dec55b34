"""A fleet in the orchestrator's own process: puppets answer every assignment at once, with a file made beforehand.

They carry the bytes of the protocol, and read them with its functions, so that what the orchestrator pays for a message
is paid here too; only the network is missing. What the puppets themselves take is counted apart.
"""

import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.software import software
from perfbound.orchestrator.fleet.link.transport import Heartbeat, Result, Sink, Token
from perfbound.orchestrator.run.service import Interrupted, RunStatus, Service
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas import __version__
from perfbound.schemas.errors import Stopped
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.link.messages import (
    PROTOCOL,
    Assign,
    Request,
    ResultHeader,
    WorkerState,
    decode_header,
    decode_request,
    decode_state,
    encode_message,
)
from perfbound.schemas.link.seal import result_proof
from perfbound.schemas.platforms import platform_class
from perfbound.schemas.result.facts import Header
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.schemas.trajectory.trajectory import encode as encode_file
from perfbound.workers.systems import load_system
from tests.patience import patience

RATE = 100
"""Samples of a trajectory per second."""


def scratch() -> tempfile.TemporaryDirectory[str]:
    """Return a folder for as long as it is wanted, on the disk of this checkout."""
    Path("build").mkdir(exist_ok=True)
    return tempfile.TemporaryDirectory(dir="build")


def worker_state(
    worker: str, spec: SystemSpec, assign: Assign | None = None, progress: int = 0, *, host: str = "h", pid: int = 1
) -> WorkerState:
    """Return the state of a worker that fits a campaign of a system: at work on an assignment, or idle."""
    return WorkerState(
        protocol=PROTOCOL,
        version=__version__,
        worker=worker,
        host=host,
        platform=platform_class(),
        pid=pid,
        systems={spec.name: spec.digest},
        state="busy" if assign else "idle",
        rollout=assign.request.rollout if assign else None,
        attempt=assign.attempt if assign else None,
        progress=progress,
    )


class Clock:
    """Seconds of wall and CPU time of this process."""

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Add what passes inside."""
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.wall += time.perf_counter() - wall
            self.cpu += time.process_time() - cpu


class Puppets:
    """`count` workers behind the orchestrator's port; each reports `beats` times on every rollout."""

    endpoint = "memory/here:0"

    def __init__(self, spec: SystemSpec, count: int, *, beats: int = 0) -> None:
        self.own = Clock()
        """Cost of the puppets themselves."""
        self.delivered = 0
        self.beaten = 0
        self.holding = False
        """Whether they keep what they are assigned, and stay busy."""
        self._held: dict[str, Assign] = {}
        self._beats = beats
        self.names = [f"puppet-{number:05d}" for number in range(count)]
        self._spec = spec
        self._sink: Sink

    def start(self, run: str, sink: Sink) -> None:
        """Show all puppets, idle."""
        self._sink = sink
        for name in self.names:
            sink(Token(time.monotonic(), name, alive=True))
            self.beat(name)

    def beat(self, name: str, attempt: Assign | None = None, progress: int = 0) -> None:
        """Send one heartbeat."""
        with self.own.running():
            payload = encode_message(worker_state(name, self._spec, attempt, progress, host="memory"))
        self.beaten += 1
        self._sink(Heartbeat(time.monotonic(), name, decode_state(payload)))

    def beat_all(self, rounds: int) -> None:
        """Send heartbeats of all, busy with what they hold."""
        for _ in range(rounds):
            for name in self.names:
                self.beat(name, self._held.get(name), self.beaten)

    def send(self, worker: str, message: Request) -> None:
        """Answer an assignment."""
        payload = encode_message(message)
        if not isinstance(message, Assign):
            return
        if self.holding:
            self._held[worker] = message
            return
        with self.own.running():
            assign = decode_request(payload)
            assert isinstance(assign, Assign)
            header, file = self.answer(worker, assign)
            attachment = encode_message(header.model_copy(update={"proof": result_proof(assign.secret, header)}))
        for number in range(self._beats):
            self.beat(worker, assign, number + 1)
        self.delivered += 1
        self._sink(Result(time.monotonic(), worker, decode_header(attachment), file))

    def answer(self, worker: str, assign: Assign) -> tuple[ResultHeader, bytes]:
        """Return the result of an assignment: its header, and its file."""
        file = self.file(assign.request)
        sha256, rollout = hashlib.sha256(file).hexdigest(), assign.request.rollout
        return ResultHeader(rollout=rollout, attempt=assign.attempt, worker=worker, outcome="done", sha256=sha256), file

    def file(self, request: RolloutRequest) -> bytes:
        """Return a trajectory's file for `request`: little noise around 0, from the seed."""
        spec = self._spec
        names = tuple(column.name for column in spec.columns)
        t = np.arange(round(request.horizon * RATE) + 1) / RATE
        values = np.random.default_rng(request.seed).uniform(0.0, 0.1, (len(t), len(names) - 1))
        trajectory = Trajectory(names, np.column_stack((t, values)))
        units = {column.name: column.unit for column in spec.columns}
        dumped = request.model_dump(mode="json")
        return encode_file(trajectory, request=dumped, metadata=request.metadata, units=units)


class Stage:
    """A campaign in `directory`, whose workers are puppets."""

    def __init__(self, directory: Path, config: CampaignConfig, count: int, *, beats: int = 0) -> None:
        spec = load_system(config.system.name).spec
        directory.mkdir(parents=True, exist_ok=True)
        self.journal = Journal.create(directory, Header.new(config, spec, software(spec)))
        self.ledger = Ledger(directory, self.journal)
        self.puppets = Puppets(spec, count, beats=beats)
        self.clock = Clock()

    def play(self, over: Callable[[], bool] = lambda: False) -> None:
        """Run the campaign to its end, or until it is `over` by the clock.

        Raises:
            TimeoutError: it is neither.

        """
        late = patience()

        def look() -> None:
            if over() or late():
                service.inbox.put(Interrupted(2))

        service = Service(self.ledger, self.journal, self.puppets, None, [_Listener(look)], resumed=False)
        self.puppets.start(self.journal.header.run, service.inbox.put)
        with suppress(Stopped), self.clock.running():
            service.run()
        if late():
            raise TimeoutError("the campaign does not end")

    def per_rollout(self) -> tuple[float, float]:
        """Return wall and CPU seconds a rollout, without what the puppets took."""
        own, count = self.puppets.own, self.puppets.delivered
        return (self.clock.wall - own.wall) / count, (self.clock.cpu - own.cpu) / count


class _Listener:
    def __init__(self, look: Callable[[], None]) -> None:
        self._look = look

    def print_line(self, line: str) -> None:
        """Keep silent."""

    def show(self, status: RunStatus) -> None:
        """Call `look`."""
        self._look()
