"""The orchestrator's side of the protocol; the only importer of zenoh in this package."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import zenoh

from ...schemas import keys
from ...schemas.errors import LinkError, MessageError, PerfboundError, shortened
from ...schemas.link import Tls, listen_config, reachable, with_port
from ...schemas.messages import (
    MAX_RESULT,
    Request,
    ResultHeader,
    WorkerState,
    decode_header,
    decode_state,
    encode_message,
)
from .inbox import Budget
from .sender import Sender, join_all, within_patience

CHANNEL = 4096
"""Messages that may wait for a reader thread; every worker has one rollout outstanding, so it cannot fill."""
TRIES = 5
"""Free ports that are tried where the endpoint names none."""
IN_USE = "Address already in use"


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


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Result:
    """The end of an attempt."""

    at: float
    worker: str
    header: ResultHeader
    payload: bytes


@dataclass(frozen=True, slots=True)
class Garbage:
    """A message that is not of the protocol, and the reason."""

    at: float
    worker: str
    reason: str


Inbound = Token | Heartbeat | Result | Garbage
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
    """A Zenoh session that listens for workers."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self._endpoint = endpoint
        self._run = ""
        self._threads: list[threading.Thread] = []
        self._sender = Sender(self._put)
        self._budget = Budget()

    @property
    def endpoint(self) -> str:
        """Zenoh endpoint that workers connect to."""
        return self._endpoint

    def start(self, run: str, sink: Sink) -> None:
        """Subscribe to the workers of `run`, then announce the orchestrator."""
        self._run = run
        handler = zenoh.handlers.FifoChannel
        session, liveliness = self._session, self._session.liveliness()
        states = session.declare_subscriber(keys.state_key(run, "*"), handler(CHANNEL))
        results = session.declare_subscriber(keys.result_key(run, "*", "*", "*"), handler(CHANNEL))
        tokens = liveliness.declare_subscriber(keys.live_worker(run, "*"), handler(CHANNEL), history=True)
        for subscriber, read in ((states, _heartbeat), (results, partial(_result, self._budget)), (tokens, _token)):
            thread = threading.Thread(target=_pump, args=(subscriber, read, sink), daemon=True)
            thread.start()
            self._threads.append(thread)
        # Last: a worker that has found the token may send at once. The time makes ids sort by age, and workers without
        # --run join the first.
        name = keys.fresh_id(f"{time.time_ns() // 1_000_000:013d}")
        self._token = liveliness.declare_token(keys.live_orchestrator(run, name))

    def send(self, worker: str, message: Request) -> None:
        """Send a request without waiting for its peer."""
        self._sender.send(worker, message)

    def _put(self, worker: str, message: Request) -> None:
        with suppress(zenoh.ZError):  # the session is closed: the run has ended
            # With BLOCK, because DROP, the default, loses messages under load.
            self._session.put(
                keys.request_key(self._run, worker),
                encode_message(message),
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )

    def close(self) -> None:
        """Send what waits, close the session, and wait for the reader threads (one in recv() at exit aborts).

        A peer that does not read can hold up each of the three, so none is waited for without a limit.
        """
        self._sender.finish()
        within_patience(self._session.close)
        join_all(self._threads)


@contextmanager
def listen(endpoint: str, tls: Tls | None = None, *, insecure: bool = False) -> Iterator[ZenohTransport]:
    """Open a Zenoh session that workers can connect to.

    Raises:
        PerfboundError: the endpoint is in use, malformed, or open to others without TLS.

    """
    session, chosen = _opened(endpoint, tls, insecure=insecure)
    transport = ZenohTransport(session, reachable(chosen))
    try:
        yield transport
    finally:
        transport.close()


def _opened(endpoint: str, tls: Tls | None, *, insecure: bool) -> tuple[zenoh.Session, str]:
    """Return a session that listens, and its endpoint; port 0 becomes a free one."""
    tries = TRIES
    while True:
        tries -= 1
        try:
            listen_config(endpoint, tls, insecure=insecure)
            chosen = with_port(endpoint)
            return zenoh.open(zenoh.Config.from_json5(listen_config(chosen, tls, insecure=insecure))), chosen
        except LinkError as error:
            raise PerfboundError(str(error)) from None
        except zenoh.ZError as error:
            # Between the choice of a free port and its use, another process may have taken it.
            if not (tries and chosen != endpoint and IN_USE in str(error)):
                raise PerfboundError(_explain(endpoint, str(error))) from None


def _explain(endpoint: str, error: str) -> str:
    if IN_USE in error:
        return f"--listen {endpoint}: this endpoint is in use; choose another port, or 0 for a free one"
    reason = error.split(" at /", maxsplit=1)[0][:300]
    return f"--listen {endpoint}: cannot listen there ({reason}); check the address and the TLS files"


def _pump(subscriber: Any, read: Callable[[zenoh.Sample, float], Inbound | None], sink: Sink) -> None:
    try:
        for sample in subscriber:
            at = time.monotonic()
            try:
                message = read(sample, at)
            except (MessageError, UnicodeDecodeError) as error:
                message = Garbage(at, keys.sender_of(str(sample.key_expr)), shortened(str(error)))
            if message is not None:
                sink(message)
            del sample, message  # megabytes, which would stay until the next one is read
    except zenoh.ZError:
        return  # the session is closed


def _token(sample: zenoh.Sample, at: float) -> Inbound:
    return Token(at, keys.worker_of(str(sample.key_expr)), alive=sample.kind == zenoh.SampleKind.PUT)


def _heartbeat(sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    return Heartbeat(at, keys.worker_of(str(sample.key_expr)), decode_state(sample.payload.to_bytes()))


def _result(budget: Budget, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    if sample.attachment is None:
        raise MessageError("a result without its header")
    header = decode_header(sample.attachment.to_bytes())
    if len(sample.payload) > MAX_RESULT:
        raise MessageError(f"{len(sample.payload)} bytes are more than the {MAX_RESULT} of a trajectory")
    worker, size = keys.worker_of(str(sample.key_expr)), len(sample.payload)
    budget.reserve(worker, size)
    result = Result(at, worker, header, sample.payload.to_bytes())
    budget.release_with(result, size)
    return result
