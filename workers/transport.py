"""The worker's side of the protocol; the only importer of zenoh in this package."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import zenoh

from ..schemas.errors import MessageError
from ..schemas.link import key_expressions
from ..schemas.link.configuration import Tls, connect_configs
from ..schemas.link.ends import Packet, WorkerEnd
from ..schemas.link.messages import Request, ResultHeader, WorkerState
from ..schemas.link.unanswered import first_opened

Receiver = Callable[[Request], None]


class Uplink(Protocol):
    """A network for a worker."""

    def orchestrators(self) -> list[tuple[str, str]]:
        """Return (orchestrator, run) of all that are alive and know the secret, the oldest first."""
        ...

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        """Subscribe to the requests to `worker`, then announce it as alive."""
        ...

    def leave(self) -> None:
        """Withdraw the announcement and the subscription."""
        ...

    def report(self, state: WorkerState) -> None:
        """Send a heartbeat."""
        ...

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Send a result."""
        ...


class ZenohUplink:
    """A Zenoh session with the orchestrator, or with a router between."""

    def __init__(self, session: zenoh.Session, secret: bytes | None) -> None:
        self._session = session
        self._end = WorkerEnd(secret)
        self._joined: tuple[Any, ...] = ()
        self._threads: list[threading.Thread] = []
        liveliness = session.liveliness()
        tokens = liveliness.declare_subscriber(
            key_expressions.ANY_ORCHESTRATOR, zenoh.handlers.FifoChannel(1024), history=True
        )
        self._pump(tokens, self._see)
        routers = liveliness.declare_subscriber(
            key_expressions.live_router("*"), zenoh.handlers.FifoChannel(1024), history=True
        )
        self._pump(routers, lambda each: self._end.router(str(each.key_expr), alive=each.kind == zenoh.SampleKind.PUT))

    @property
    def linked(self) -> bool:
        """Whether there is a link to a router or an orchestrator."""
        return bool(self._session.info.routers_zid() or self._session.info.peers_zid())

    def by_certificate(self, orchestrator: str) -> bool:
        """Whether it, or a router, hears this worker only under the common name of its certificate."""
        return self._end.by_certificate(orchestrator)

    @property
    def routed(self) -> bool:
        """Whether there is a link to a router."""
        return bool(self._session.info.routers_zid())

    @property
    def strangers(self) -> bool:
        """Whether an orchestrator is there that does not know the secret."""
        return self._end.strangers

    def orchestrators(self) -> list[tuple[str, str]]:
        """Return (orchestrator, run) of all that are alive and know the secret, the oldest first."""
        return self._end.orchestrators()

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        """Subscribe to the requests to `worker`; its token comes last, because assignments follow it."""
        self._end.join(run, worker)
        requests = self._session.declare_subscriber(
            key_expressions.request_key(run, worker), zenoh.handlers.FifoChannel(1024)
        )
        self._pump(requests, lambda sample: self._pass_request(sample, receive))
        token = self._session.liveliness().declare_token(key_expressions.live_worker(run, worker))
        self._joined = (token, requests)

    def leave(self) -> None:
        """Withdraw the token, then the subscription."""
        for declared in self._joined:
            declared.undeclare()
        self._joined = ()

    def report(self, state: WorkerState) -> None:
        """Put a heartbeat."""
        self._put(self._end.state(state))

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Put a result."""
        self._put(self._end.result(header, payload))

    def _put(self, packet: Packet | None) -> None:
        if packet is not None:
            # DROP, the default, loses messages under load.
            block = zenoh.CongestionControl.BLOCK
            key, payload, attachment = packet
            self._session.put(key, payload, attachment=attachment, congestion_control=block, express=True)

    def _pass_request(self, sample: zenoh.Sample, receive: Receiver) -> None:
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        try:
            receive(self._end.request(sample.payload.to_bytes(), attachment))
        except MessageError:
            return  # the orchestrator repeats an assignment, a cancel and an acknowledgement

    def _see(self, sample: zenoh.Sample) -> None:
        take = self._end.appear if sample.kind == zenoh.SampleKind.PUT else self._end.disappear
        take(str(sample.key_expr))

    def _pump(self, subscriber: Any, read: Callable[[zenoh.Sample], None]) -> None:
        def pump() -> None:
            try:
                for sample in subscriber:
                    read(sample)
            except zenoh.ZError:
                return  # the session is closed

        thread = threading.Thread(target=pump, daemon=True)
        thread.start()
        self._threads.append(thread)

    def wait_closed(self) -> None:
        """Wait for the reader threads; after the session is closed (a reader inside recv() at exit aborts)."""
        for thread in self._threads:
            thread.join(timeout=2)


@contextmanager
def connect(
    endpoints: Sequence[str], tls: Tls | None, waiting: Callable[[], None], secret: bytes | None = None
) -> Iterator[ZenohUplink]:
    """Open a session with the first of `endpoints` that answers; `waiting` is called between tries and may raise.

    Raises:
        LinkError: the endpoint is malformed or a TLS file is missing.

    """
    configs = connect_configs(endpoints, tls, secret)
    session = first_opened(configs, lambda config: zenoh.open(zenoh.Config.from_json5(config)), zenoh.ZError, waiting)
    uplink = None
    try:
        uplink = ZenohUplink(session, secret)
        yield uplink
    finally:
        session.close()  # type: ignore[no-untyped-call]
        if uplink is not None:
            uplink.wait_closed()
