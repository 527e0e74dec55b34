"""Both transport ports in memory, joined by a scripted network; and a whole campaign in one process.

The network carries bytes under the keys of the protocol, as Zenoh does, and reads them with the same functions of
`perfbound.schemas.link.messages`. What it loses, delays and repeats follows from a seed; liveliness tokens are never
lost.
"""

import heapq
import itertools
import random
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType

import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.software import software
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.issue import issue, manifest
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.link.transport import Heartbeat, Inbound, Result, Sink, Token, garbage
from perfbound.orchestrator.run import outbox, service
from perfbound.orchestrator.run.service import Interrupted, RunStatus, Service
from perfbound.orchestrator.run.trust import doubted
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.schemas.errors import MessageError, RefusedError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.ends import OrchestratorEnd, Packet, WorkerEnd
from perfbound.schemas.link.messages import MAX_RESULT, Refuse, Request, ResultHeader, WorkerState
from perfbound.schemas.result.facts import Header
from perfbound.workers import worker as worker_module
from perfbound.workers.systems import load_system
from perfbound.workers.transport import Receiver, Uplink
from perfbound.workers.worker import WorkerProcess
from tests.patience import patience

# The network


@dataclass(frozen=True)
class Faults:
    """Faults of the network: shares in [0, 1], and the longest delay in s (so that messages overtake)."""

    seed: int = 0
    loss: float = 0.0
    duplication: float = 0.0
    delay: float = 0.0


class Network:
    """One thread that carries messages; closed, it carries nothing more."""

    def __init__(self, faults: Faults | None = None, secret: bytes | None = b"the secret of the tests") -> None:
        self._faults = faults or Faults()
        self.secret = secret
        """Of every end that joins it, unless that one has another."""
        self._luck = random.Random(self._faults.seed)
        self._order = itertools.count()
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self._changed = threading.Condition()
        self._closed = False
        self.transports: dict[str, InMemoryTransport] = {}
        """By orchestrator."""
        self.uplinks: dict[tuple[str, str], InMemoryUplink] = {}
        """By run and worker."""
        self.announced: list[str] = []
        """Tokens of live orchestrators."""
        self.watching: list[WorkerEnd] = []
        """Workers that see these tokens."""
        self._thread = threading.Thread(target=self._carry, name="in-memory network")
        self._thread.start()

    def __enter__(self) -> "Network":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def put(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Send bytes to the listeners of `key`; they may be lost, late or repeated."""
        with self._changed:
            if self._luck.random() < self._faults.loss:
                return
            copies = 2 if self._luck.random() < self._faults.duplication else 1
            for _ in range(copies):
                delay = self._luck.uniform(0, self._faults.delay)
                self._schedule(lambda: self._arrive(key, payload, attachment), delay)

    def tell(self, act: Callable[[], None]) -> None:
        """Carry a liveliness token: soon, in order, and surely."""
        with self._changed:
            self._schedule(act, 0.0)

    def announce(self, key: str, *, alive: bool) -> None:
        """Show or withdraw the token of an orchestrator; on the network's thread."""
        (self.announced.append if alive else self.announced.remove)(key)
        for each in self.watching:
            (each.appear if alive else each.disappear)(key)

    def _schedule(self, act: Callable[[], None], delay: float) -> None:
        heapq.heappush(self._agenda, (time.monotonic() + delay, next(self._order), act))
        self._changed.notify()

    def _carry(self) -> None:
        while True:
            with self._changed:
                while not self._closed and not (self._agenda and self._agenda[0][0] <= time.monotonic()):
                    self._changed.wait(self._agenda[0][0] - time.monotonic() if self._agenda else None)
                if self._closed:
                    return
                _, _, act = heapq.heappop(self._agenda)
            act()

    def _arrive(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        _, run, kind, worker, *_ = key.split("/")
        if kind == "request" and (uplink := self.uplinks.get((run, worker))) is not None:
            uplink.arrive(payload, attachment)
        for receiver in [*self.transports.values()] if kind == "up" else ():
            if receiver.run == run:
                receiver.arrive(key, payload, attachment)


class InMemoryTransport:
    """The orchestrator's port."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._sink: Sink | None = None
        self.run = ""

    @property
    def endpoint(self) -> str:
        """Endpoint that workers connect to."""
        return "memory/here:0"

    def start(self, run: str, sink: Sink) -> None:
        """Listen, report the workers that are alive, then become visible to them."""
        self.run, self._sink = run, sink
        self.end = OrchestratorEnd(self._network.secret, run)
        self._network.tell(lambda: self._appear(run))

    def _appear(self, run: str) -> None:
        self._network.transports[self.end.name] = self
        self._network.announce(key_expressions.live_orchestrator(run, self.end.name), alive=True)
        for worker in [worker for of, worker in self._network.uplinks if of == run]:
            self.hear(worker, alive=True)

    def send(self, worker: str, message: Request) -> None:
        """Send a request."""
        self._network.put(*self.end.request(worker, message))

    def stop(self) -> None:
        """Stop listening."""
        self._sink = None
        self._network.tell(self._disappear)

    def _disappear(self) -> None:
        self._network.transports.pop(self.end.name, None)
        self._network.announce(key_expressions.live_orchestrator(self.run, self.end.name), alive=False)

    def hear(self, worker: str, *, alive: bool) -> None:
        """Take a worker's token."""
        self._deliver(Token(time.monotonic(), worker, alive))

    def arrive(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        """Take what a worker put."""
        at, worker = time.monotonic(), key_expressions.sender_of(key)
        try:
            self._deliver(_read(self.end, at, key, payload, attachment))
        except MessageError as error:
            self._deliver(garbage(self.end, at, worker, error))

    def _deliver(self, message: Inbound | None) -> None:
        if (sink := self._sink) is not None and message is not None:
            sink(message)


def _read(end: OrchestratorEnd, at: float, key: str, payload: bytes, attachment: bytes | None) -> Inbound:
    worker = key_expressions.worker_of(key)
    if key_expressions.last(key) == "state":
        return Heartbeat(at, worker, end.state(worker, payload, attachment))
    header = end.header(worker, attachment)
    if len(payload) > MAX_RESULT:
        raise MessageError(f"{len(payload)} bytes are more than the {MAX_RESULT} of a trajectory")
    return Result(at, worker, header, payload)


class InMemoryUplink:
    """A worker's port."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._end = WorkerEnd(network.secret)
        self._run, self._worker = "", ""
        self._receive: Receiver | None = None
        network.tell(self._look)

    def _look(self) -> None:
        self._network.watching.append(self._end)
        for key in self._network.announced:
            self._end.appear(key)

    def orchestrators(self) -> list[tuple[str, str]]:
        """Return (orchestrator, run) of all that are alive and know the secret, the oldest first."""
        return self._end.orchestrators()

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        """Listen for requests, then show ourselves."""
        self._run, self._worker, self._receive = run, worker, receive
        self._end.join(run, worker)
        self._network.tell(self._appear)

    def _appear(self) -> None:
        self._network.uplinks[self._run, self._worker] = self
        self._show(self._run, self._worker, alive=True)

    def leave(self) -> None:
        """No longer listen or show."""
        self._receive = None
        run, worker = self._run, self._worker
        self._network.tell(lambda: self._disappear(run, worker))

    def _disappear(self, run: str, worker: str) -> None:
        if self._network.uplinks.pop((run, worker), None) is not None:
            self._show(run, worker, alive=False)

    def _show(self, run: str, worker: str, *, alive: bool) -> None:
        for each in [*self._network.transports.values()]:
            if each.run == run:
                each.hear(worker, alive=alive)

    def report(self, state: WorkerState) -> None:
        """Send a heartbeat."""
        self._put(self._end.state(state))

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Send a result."""
        self._put(self._end.result(header, payload))

    def _put(self, packet: Packet | None) -> None:
        if packet is not None:
            self._network.put(*packet)

    def arrive(self, payload: bytes, attachment: bytes | None) -> None:
        """Take a request."""
        if (receive := self._receive) is not None:
            try:
                receive(self._end.request(payload, attachment))
            except MessageError:
                return


# A campaign

Wrap = Callable[[InMemoryUplink], Uplink]
"""Puts a fault between a worker and the network, for instance false messages."""


class Log:
    """A listener that keeps its lines and calls `look` at every status."""

    def __init__(self, look: Callable[[RunStatus], None] = lambda _: None) -> None:
        self.lines: list[str] = []
        self._look = look

    def print_line(self, line: str) -> None:
        """Keep a line."""
        self.lines.append(line)

    def show(self, status: RunStatus) -> None:
        """Call `look`."""
        self._look(status)


@contextmanager
def working(network: Network, run: str, wraps: Sequence[Wrap]) -> Iterator[list[str]]:
    """Run one worker in a thread for each of `wraps`; yield the reasons why workers were refused."""
    refused: list[str] = []

    def live(worker: WorkerProcess, uplink: Uplink) -> None:
        uplink.join(run, worker.name, worker.receive)
        try:
            worker.serve(lambda _: False)
        except RefusedError as error:
            refused.append(str(error))
        uplink.leave()

    threads, workers = [], []
    for number, wrap in enumerate(wraps):
        uplink = wrap(InMemoryUplink(network))
        worker = WorkerProcess(key_expressions.fresh_id(f"worker-{number}"), uplink)
        threads.append(threading.Thread(target=live, args=(worker, uplink), name=worker.name))
        workers.append(worker)
    for thread in threads:
        thread.start()
    try:
        yield refused
    finally:
        for worker in workers:
            worker.receive(Refuse(reason="the test is over"))
        for thread in threads:
            thread.join()


def hurry(monkeypatch: pytest.MonkeyPatch, *, tick: float) -> None:
    """Leave everything as it is, in a tenth of the time."""
    monkeypatch.setattr(service, "TICK", tick)
    monkeypatch.setattr(service, "ADOPTION", 0.2)
    monkeypatch.setattr(worker_module, "HEARTBEAT", 0.04)
    monkeypatch.setattr(worker_module, "RESEND", 0.1)
    monkeypatch.setattr(service, "Limits", partial(Limits, resend_after=0.15, lost_after=0.3, others_within=0.5))


def begin(directory: Path, config: CampaignConfig) -> None:
    """Make the run directory of a campaign."""
    spec = load_system(config.system.name).spec
    check_against(config, spec, "test")
    directory.mkdir(parents=True)
    Journal.create(directory, Header.new(config, spec, software(spec))).close()


def serve(
    directory: Path,
    network: Network,
    log: Log,
    *,
    stop: Callable[[RunStatus], bool] = lambda _: False,
    resumed: bool = False,
    drain: bool = False,
) -> str:
    """Be the orchestrator of the campaign in `directory`, once; return the certificate's text.

    Raises:
        Stopped: `stop` returned True; called at every tick.
        PerfboundError: as `Service.run`.
        TimeoutError: the campaign does not end.

    """
    with campaign_lock(directory), ExitStack() as stack:
        journal = Journal.open(directory)
        stack.callback(journal.close)
        ledger = Ledger(directory, journal)
        ledger.replay()
        ledger.check_files(journal)
        if not ledger.done or any(doubted(journal)):
            port = InMemoryTransport(network)
            stack.callback(port.stop)
            server = Service(ledger, journal, port, None, [log], resumed=resumed, drain=drain)
            late = patience()
            log._look = lambda seen: server.inbox.put(Interrupted(2)) if stop(seen) or late() else None
            port.start(journal.header.run, server.inbox.put)
            try:
                server.run()
            finally:
                if late():
                    raise TimeoutError(f"the campaign does not end; its last lines: {log.lines[-3:]}")
        outbox.forget(directory)
        found = manifest((sha256, path) for _, sha256, path in read.observed(directory))
        known = {"irreproducible": read.irreproducible(directory), "contradicted": read.contradicted(directory)}
        files.write(directory, issue(ledger, found, **known), found.text)  # type: ignore[arg-type]
    return (directory / files.CERTIFICATE).read_text()


def run_of(directory: Path) -> str:
    """Return the run id of a campaign."""
    journal = Journal.open(directory)
    journal.close()
    return journal.header.run


def campaign(
    directory: Path,
    config: CampaignConfig,
    *,
    workers: int = 1,
    faults: Faults | None = None,
    wraps: Sequence[Wrap] = (),
    log: Log | None = None,
) -> str:
    """Run a campaign in a new `directory` with honest workers and those of `wraps`; return its certificate."""
    begin(directory, config)
    honest: list[Wrap] = [lambda uplink: uplink] * workers
    with Network(faults) as network, working(network, run_of(directory), [*honest, *wraps]):
        return serve(directory, network, log or Log())
