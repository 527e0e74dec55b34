"""The orchestrator's side of the protocol."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import zenoh

from ....schemas.errors import MessageError, SealError, shortened
from ....schemas.ids import Attempt, parse_work
from ....schemas.link import key_expressions, seal
from ....schemas.link.configuration import Tls, reachable
from ....schemas.link.ends import OrchestratorEnd
from ....schemas.link.messages import MAX_RESULT, Request, ResultHeader, WorkerState
from . import sessions
from .inbox import Budget
from .sender import Sender, within_patience

CHANNEL = 4096
"""Messages that may wait for a reader thread; every worker has one rollout outstanding, so it cannot fill."""
ROUTER_GRACE = 30.0
"""Seconds for workers to return after a router has come or gone: a restart of its service, not of its machine."""
LINK_PERIOD = 0.2
"""Seconds between two looks at the link to the router."""


@dataclass(frozen=True, slots=True)
class Token:
    """A worker's liveliness token appeared or disappeared."""

    at: float
    worker: str
    alive: bool


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The state of a worker."""

    at: float
    worker: str
    state: WorkerState

    @property
    def replaces(self) -> tuple[str, ...]:
        """Key of what the newest one replaces: a heartbeat says all that those before it said."""
        return (self.worker,)


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Result:
    """The end of an attempt."""

    at: float
    worker: str
    header: ResultHeader
    payload: bytes

    @property
    def replaces(self) -> tuple[str, ...]:
        """Key of what a repeat replaces; no other peer has the proof."""
        return (self.worker, self.header.rollout, str(self.header.attempt), self.header.proof)

    @property
    def attempt(self) -> Attempt:
        """The attempt that has ended."""
        return Attempt(parse_work(self.header.rollout), self.header.attempt)


@dataclass(frozen=True, slots=True)
class Garbage:
    """A message that is not of the protocol, and the reason."""

    at: float
    worker: str
    reason: str


@dataclass(frozen=True, slots=True)
class RouterToken:
    """The token of a router appeared or disappeared; those of the workers behind it do so at the same time."""

    at: float
    grace: float
    """Seconds for those workers to return."""
    router: str
    alive: bool


@dataclass(frozen=True, slots=True)
class Linked:
    """The link to the router was found up or down; sent when it changes."""

    at: float
    grace: float
    """Seconds for the workers to return once it is up."""
    up: bool


Inbound = Token | Heartbeat | Result | Garbage | RouterToken | Linked
Sink = Callable[[Inbound], None]


class Transport(Protocol):
    """A network for the service; `at` of each message is `time.monotonic()` at receipt."""

    @property
    def endpoint(self) -> str:
        """Zenoh endpoint that workers connect to."""
        ...

    def start(self, run: str, sink: Sink) -> None:
        """Begin to deliver messages of the campaign `run` to `sink`, from any thread."""
        ...

    def send(self, worker: str, message: Request) -> None:
        """Send without waiting; delivery is not guaranteed."""
        ...


class ZenohTransport:
    """A Zenoh session that listens for workers; with `grace`, in s, one with a router that they connect to as well."""

    def __init__(
        self,
        session: zenoh.Session,
        endpoint: str,
        secret: bytes | None,
        *,
        by_certificate: bool = False,
        grace: float | None = None,
    ) -> None:
        self._session = session
        self._endpoint = endpoint
        self._secret, self._by_certificate, self._grace = secret, by_certificate, grace
        self._threads: list[threading.Thread] = []
        self._closing = threading.Event()
        self._sender = Sender(self._put)
        self._budget = Budget()

    @property
    def endpoint(self) -> str:
        """Zenoh endpoint that workers connect to."""
        return self._endpoint

    def start(self, run: str, sink: Sink) -> None:
        """Subscribe to the workers of `run`, then announce the orchestrator."""
        self.end = OrchestratorEnd(self._secret, run, by_certificate=self._by_certificate)
        handler = zenoh.handlers.FifoChannel
        session, liveliness = self._session, self._session.liveliness()
        states = session.declare_subscriber(key_expressions.state_key(run, "*"), handler(CHANNEL))
        results = session.declare_subscriber(key_expressions.result_key(run, "*", "*", "*"), handler(CHANNEL))
        # With history: workers that wait for this orchestrator declared their tokens before it came.
        tokens = liveliness.declare_subscriber(key_expressions.live_worker(run, "*"), handler(CHANNEL), history=True)
        for subscriber, read in ((states, _heartbeat), (results, partial(_result, self._budget)), (tokens, _token)):
            self._pump(subscriber, read, sink)
        if self._grace is not None:
            self._watch_routers(sink, self._grace)
        # Last: a worker that has found the token may send at once.
        self._token = liveliness.declare_token(key_expressions.live_orchestrator(run, self.end.name))

    def _pump(self, subscriber: Any, read: "Read", sink: Sink) -> None:
        self._start_thread(partial(_pump, subscriber, read, self.end, sink))

    def _start_thread(self, work: Callable[[], None]) -> None:
        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        self._threads.append(thread)

    def _watch_routers(self, sink: Sink, grace: float) -> None:
        tokens = self._session.liveliness().declare_subscriber(
            key_expressions.live_router("*"), zenoh.handlers.FifoChannel(CHANNEL), history=True
        )
        self._pump(tokens, partial(_router, self._secret, grace), sink)
        self._start_thread(partial(_watch_link, self._session, self._closing, grace, sink))

    def send(self, worker: str, message: Request) -> None:
        """Send a request without waiting for its peer."""
        self._sender.send(worker, message)

    def _put(self, worker: str, message: Request) -> None:
        with suppress(zenoh.ZError):  # the session is closed: the run has ended
            # With BLOCK, because DROP, the default, loses messages under load.
            packet = self.end.request(worker, message)
            self._session.put(
                packet.key,
                packet.payload,
                attachment=packet.attachment,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )

    def close(self) -> None:
        """Send what waits, close the session, and wait for the reader threads (one in recv() at exit aborts).

        A peer that does not read can hold up each of the three, so they have one limit together.
        """
        within_patience(self._close)

    def _close(self) -> None:
        self._closing.set()
        self._sender.finish()
        self._session.close()  # type: ignore[no-untyped-call]
        for thread in self._threads:
            thread.join()


@contextmanager
def listen(
    endpoint: str,
    tls: Tls | None = None,
    *,
    insecure: bool = False,
    secret: bytes | None = None,
    access: Mapping[str, Any] | None = None,
) -> Iterator[ZenohTransport]:
    """Open a Zenoh session that workers can connect to; with `secret`, those that know it.

    Raises:
        PerfboundError: the endpoint is in use, malformed, or open to others without TLS.

    """
    session, chosen = sessions.listening(endpoint, tls, insecure=insecure, secret=secret, access=access)
    with _closed(ZenohTransport(session, reachable(chosen), secret, by_certificate=access is not None)) as transport:
        yield transport


@contextmanager
def connect_to_router(
    endpoints: Sequence[str],
    tls: Tls | None,
    secret: bytes | None,
    print_line: Callable[[str], None],
    *,
    grace: float = ROUTER_GRACE,
    patience: float = math.inf,
) -> Iterator[ZenohTransport]:
    """Open a Zenoh session with the first router of `endpoints` that answers, and wait `patience` s for it.

    Workers have `grace` s to return after a router has come or gone, or the link to it.

    Raises:
        PerfboundError: an endpoint is malformed, a TLS file is missing, or no router answers for so long.

    """
    session = sessions.connected(endpoints, tls, secret, print_line, patience)
    with _closed(ZenohTransport(session, endpoints[0], secret, grace=grace)) as transport:
        yield transport


@contextmanager
def _closed(transport: ZenohTransport) -> Iterator[ZenohTransport]:
    try:
        yield transport
    finally:
        transport.close()


Read = Callable[[OrchestratorEnd, zenoh.Sample, float], Inbound | None]


def _pump(subscriber: Any, read: Read, end: OrchestratorEnd, sink: Sink) -> None:
    try:
        for sample in subscriber:
            at = time.monotonic()
            try:
                message = read(end, sample, at)
            except (MessageError, UnicodeDecodeError) as error:
                message = garbage(end, at, key_expressions.sender_of(str(sample.key_expr)), error)
            if message is not None:
                sink(message)
            del sample, message  # megabytes, which would stay until the next one is read
    except zenoh.ZError:
        return  # the session is closed


def garbage(end: OrchestratorEnd, at: float, worker: str, error: Exception) -> Garbage | None:
    """Return what is reported of a message that is not accepted; None if that has been reported often enough."""
    reason = end.rejected(error) if isinstance(error, SealError) else shortened(str(error))
    return Garbage(at, worker, reason) if reason else None


def _token(_end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound:
    # A token has no seal, and alone admits nobody: a worker is up from its first sealed heartbeat on.
    return Token(at, key_expressions.worker_of(str(sample.key_expr)), alive=sample.kind == zenoh.SampleKind.PUT)


def _router(
    secret: bytes | None, grace: float, _end: OrchestratorEnd, sample: zenoh.Sample, at: float
) -> Inbound | None:
    name = key_expressions.last(str(sample.key_expr))
    if not seal.is_router(secret or b"", name):
        return None  # of a peer that does not know the secret: it shall not make the orchestrator wait
    return RouterToken(at, grace, name, alive=sample.kind == zenoh.SampleKind.PUT)


def _watch_link(session: zenoh.Session, closing: threading.Event, grace: float, sink: Sink) -> None:
    """Report that there is a link to a router, when it ends, and when another one is there."""
    up = True
    sink(Linked(time.monotonic(), grace, up))
    while not closing.wait(LINK_PERIOD):
        if (now := bool(session.info.routers_zid())) != up:
            up = now
            sink(Linked(time.monotonic(), grace, up))


def _heartbeat(end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    worker = key_expressions.worker_of(str(sample.key_expr))
    return Heartbeat(at, worker, end.state(worker, sample.payload.to_bytes(), _attached(sample)))


def _result(budget: Budget, end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    worker = key_expressions.worker_of(str(sample.key_expr))
    # The seal first: bytes of a stranger take no room.
    header = end.header(worker, _attached(sample))
    if len(sample.payload) > MAX_RESULT:
        raise MessageError(f"{len(sample.payload)} bytes are more than the {MAX_RESULT} of a trajectory")
    size = len(sample.payload)
    # Before the copy, which is what fills the memory.
    budget.reserve(worker, size)
    result = Result(at, worker, header, sample.payload.to_bytes())
    budget.release_with(result, size)
    return result


def _attached(sample: zenoh.Sample) -> bytes | None:
    return None if sample.attachment is None else sample.attachment.to_bytes()
