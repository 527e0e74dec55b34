"""The orchestrator's side of the protocol; the only importer of zenoh in this package."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import zenoh

from ...schemas import keys
from ...schemas.errors import LinkError, MessageError, PerfboundError, SealError
from ...schemas.link import Tls, listen_config, password_line
from ...schemas.messages import MAX_RESULT, Request, ResultHeader, WorkerState
from ...schemas.sealed import OrchestratorEnd

CHANNEL = 4096
"""Messages that may wait for a reader thread; every worker has one rollout outstanding, so it cannot fill."""


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


@dataclass(frozen=True, slots=True)
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

    def __init__(
        self, session: zenoh.Session, endpoint: str, secret: bytes | None, *, by_certificate: bool = False
    ) -> None:
        self._session = session
        self._endpoint = endpoint
        self._secret, self._by_certificate = secret, by_certificate
        self._threads: list[threading.Thread] = []

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
        for subscriber, read in ((states, _heartbeat), (results, _result), (tokens, _token)):
            thread = threading.Thread(target=_pump, args=(subscriber, read, self.end, sink), daemon=True)
            thread.start()
            self._threads.append(thread)
        # Last: a worker that has found the token may send at once.
        self._token = liveliness.declare_token(keys.live_orchestrator(run, self.end.name))

    def send(self, worker: str, message: Request) -> None:
        """Put a request; with BLOCK, because DROP, the default, loses messages under load."""
        packet = self.end.request(worker, message)
        self._session.put(
            packet.key,
            packet.payload,
            attachment=packet.attachment,
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )

    def join(self) -> None:
        """Wait for the reader threads; after the session is closed (a reader inside recv() at exit aborts)."""
        for thread in self._threads:
            thread.join(timeout=2)


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
    try:
        with _passwords(secret) as passwords:
            text = listen_config(endpoint, tls, insecure=insecure, passwords=passwords, access=access)
            session = zenoh.open(zenoh.Config.from_json5(text))
    except LinkError as error:
        raise PerfboundError(str(error)) from None
    except zenoh.ZError as error:
        raise PerfboundError(_explain(endpoint, str(error))) from None
    transport = None
    try:
        transport = ZenohTransport(session, _chosen(session, endpoint), secret, by_certificate=access is not None)
        yield transport
    finally:
        session.close()  # type: ignore[no-untyped-call]
        if transport is not None:
            transport.join()


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
    if "Address already in use" in error:
        return f"--listen {endpoint}: this endpoint is in use; choose another port, or 0 for a free one"
    reason = error.split(" at /", maxsplit=1)[0][:300]
    return f"--listen {endpoint}: cannot listen there ({reason}); check the address and the TLS files"


def _chosen(session: zenoh.Session, endpoint: str) -> str:
    for reply in session.get(f"@/{session.zid()}/*"):
        if reply.ok is not None:
            locators = json.loads(reply.ok.payload.to_bytes())["locators"]
            if locators:
                return str(locators[0])
    return endpoint


Read = Callable[[OrchestratorEnd, zenoh.Sample, float], Inbound | None]


def _pump(subscriber: Any, read: Read, end: OrchestratorEnd, sink: Sink) -> None:
    try:
        for sample in subscriber:
            at = time.monotonic()
            try:
                message = read(end, sample, at)
            except (MessageError, UnicodeDecodeError) as error:
                message = garbage(end, at, keys.worker_of(str(sample.key_expr)), error)
            if message is not None:
                sink(message)
    except zenoh.ZError:
        return  # the session is closed


def garbage(end: OrchestratorEnd, at: float, worker: str, error: Exception) -> Garbage | None:
    """Return what is reported of a message that is not accepted; None if that has been reported often enough."""
    reason = end.rejected(error) if isinstance(error, SealError) else str(error)
    return Garbage(at, worker, reason) if reason else None


def _token(_end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound:
    return Token(at, keys.last(str(sample.key_expr)), alive=sample.kind == zenoh.SampleKind.PUT)


def _heartbeat(end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    worker = keys.worker_of(str(sample.key_expr))
    return Heartbeat(at, worker, end.state(worker, sample.payload.to_bytes(), _attachment(sample)))


def _result(end: OrchestratorEnd, sample: zenoh.Sample, at: float) -> Inbound | None:
    if sample.kind != zenoh.SampleKind.PUT:
        return None
    worker = keys.worker_of(str(sample.key_expr))
    header = end.header(worker, _attachment(sample))
    if len(sample.payload) > MAX_RESULT:
        raise MessageError(f"{len(sample.payload)} bytes are more than the {MAX_RESULT} of a trajectory")
    return Result(at, worker, header, sample.payload.to_bytes())


def _attachment(sample: zenoh.Sample) -> bytes | None:
    return None if sample.attachment is None else sample.attachment.to_bytes()
