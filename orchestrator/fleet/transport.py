"""The orchestrator's side of the protocol; the only importer of zenoh in this package."""

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import zenoh

from ...schemas import keys
from ...schemas.errors import LinkError, MessageError, PerfboundError, SealError, shortened
from ...schemas.ids import Attempt, RolloutId
from ...schemas.link import Tls, listen_config, password_line, reachable, with_port
from ...schemas.messages import MAX_RESULT, Request, ResultHeader, WorkerState
from ...schemas.sealed import OrchestratorEnd
from .inbox import Budget
from .sender import Sender, within_patience

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

    @property
    def attempt(self) -> Attempt:
        """The attempt that has ended."""
        return Attempt(RolloutId.parse(self.header.rollout), self.header.attempt)


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

    def __init__(
        self, session: zenoh.Session, endpoint: str, secret: bytes | None, *, by_certificate: bool = False
    ) -> None:
        self._session = session
        self._endpoint = endpoint
        self._secret, self._by_certificate = secret, by_certificate
        self._threads: list[threading.Thread] = []
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
        states = session.declare_subscriber(keys.state_key(run, "*"), handler(CHANNEL))
        results = session.declare_subscriber(keys.result_key(run, "*", "*", "*"), handler(CHANNEL))
        tokens = liveliness.declare_subscriber(keys.live_worker(run, "*"), handler(CHANNEL), history=True)
        for subscriber, read in ((states, _heartbeat), (results, partial(_result, self._budget)), (tokens, _token)):
            thread = threading.Thread(target=_pump, args=(subscriber, read, self.end, sink), daemon=True)
            thread.start()
            self._threads.append(thread)
        # Last: a worker that has found the token may send at once.
        self._token = liveliness.declare_token(keys.live_orchestrator(run, self.end.name))

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
    with _passwords(secret) as passwords:
        configured = partial(listen_config, tls=tls, insecure=insecure, passwords=passwords, access=access)
        session, chosen = _listening(endpoint, configured)
    transport = ZenohTransport(session, reachable(chosen), secret, by_certificate=access is not None)
    try:
        yield transport
    finally:
        transport.close()


def _listening(endpoint: str, configured: Callable[[str], str]) -> tuple[zenoh.Session, str]:
    """Return a session that listens, and its endpoint; port 0 becomes a free one."""
    tries = TRIES
    while True:
        tries -= 1
        try:
            configured(endpoint)
            chosen = with_port(endpoint)
            return zenoh.open(zenoh.Config.from_json5(configured(chosen))), chosen
        except LinkError as error:
            raise PerfboundError(str(error)) from None
        except zenoh.ZError as error:
            # Between the choice of a free port and its use, another process may have taken it.
            if not (tries and chosen != endpoint and IN_USE in str(error)):
                raise PerfboundError(_explain(endpoint, str(error))) from None


@contextmanager
def _passwords(secret: bytes | None) -> Iterator[str | None]:
    """Make the file that Zenoh reads passwords from when it opens; it has no name, so no disk keeps it."""
    if secret is None:
        yield None
        return
    with os.fdopen(os.memfd_create("perfbound"), "wb") as file:
        file.write(password_line(secret).encode())
        file.flush()
        yield f"/proc/self/fd/{file.fileno()}"


def _explain(endpoint: str, error: str) -> str:
    if IN_USE in error:
        return f"--listen {endpoint}: this endpoint is in use; choose another port, or 0 for a free one"
    reason = error.split(" at /", maxsplit=1)[0][:300]
    return f"--listen {endpoint}: cannot listen there ({reason}); check the address and the TLS files"


Read = Callable[[OrchestratorEnd, zenoh.Sample, float], Inbound | None]


def _pump(subscriber: Any, read: Read, end: OrchestratorEnd, sink: Sink) -> None:
    try:
        for sample in subscriber:
            at = time.monotonic()
            try:
                message = read(end, sample, at)
            except (MessageError, UnicodeDecodeError) as error:
                message = garbage(end, at, keys.sender_of(str(sample.key_expr)), error)
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
    return Token(at, keys.worker_of(str(sample.key_expr)), alive=sample.kind == zenoh.SampleKind.PUT)


def _heartbeat(end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    worker = keys.worker_of(str(sample.key_expr))
    return Heartbeat(at, worker, end.state(worker, sample.payload.to_bytes(), _attached(sample)))


def _result(budget: Budget, end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    worker = keys.worker_of(str(sample.key_expr))
    header = end.header(worker, _attached(sample))
    if len(sample.payload) > MAX_RESULT:
        raise MessageError(f"{len(sample.payload)} bytes are more than the {MAX_RESULT} of a trajectory")
    size = len(sample.payload)
    budget.reserve(worker, size)
    result = Result(at, worker, header, sample.payload.to_bytes())
    budget.release_with(result, size)
    return result


def _attached(sample: zenoh.Sample) -> bytes | None:
    return None if sample.attachment is None else sample.attachment.to_bytes()
