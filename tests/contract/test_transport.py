"""The contract of both transports: Zenoh on loopback, and the one in memory."""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from typing import TypeVar, get_args

import pytest
import zenoh

from perfbound.orchestrator.fleet import transport as port
from perfbound.orchestrator.fleet.transport import Garbage, Heartbeat, Inbound, Result, Token, Transport, listen
from perfbound.schemas import keys
from perfbound.schemas.failure import FailureKind
from perfbound.schemas.link import LOCAL, connect_config
from perfbound.schemas.messages import (
    MAX_MESSAGE,
    PROTOCOL,
    Ack,
    Cancel,
    Request,
    ResultHeader,
    WorkerState,
    encode_message,
)
from perfbound.workers.transport import Uplink, connect
from tests.fakes import inmemory
from tests.fakes.inmemory import InMemoryTransport, InMemoryUplink, Network
from tests.patience import PATIENCE

pytestmark = pytest.mark.smoke
RUN = "0123456789abcdef"
T = TypeVar("T")


@dataclass
class Rig:
    """An orchestrator's transport, a way to add workers, and a way to put anything."""

    transport: Transport
    uplink: Callable[[], AbstractContextManager[Uplink]]
    put: Callable[[str, bytes, bytes | None], None]


def no_waiting() -> None:
    raise AssertionError("the orchestrator listens already")


@contextmanager
def zenoh_rig() -> Iterator[Rig]:
    with listen(LOCAL) as transport:
        raw = zenoh.open(zenoh.Config.from_json5(connect_config(transport.endpoint, None)))
        try:
            block = zenoh.CongestionControl.BLOCK
            yield Rig(
                transport,
                lambda: connect(transport.endpoint, None, no_waiting),
                lambda key, payload, header: raw.put(key, payload, attachment=header, congestion_control=block),
            )
        finally:
            raw.close()  # type: ignore[no-untyped-call]


@contextmanager
def memory_rig() -> Iterator[Rig]:
    @contextmanager
    def uplink() -> Iterator[Uplink]:
        joined = InMemoryUplink(network)
        yield joined
        joined.leave()

    with Network() as network:
        transport = InMemoryTransport(network)
        yield Rig(transport, uplink, network.put)
        transport.stop()


RIGS = {"zenoh": zenoh_rig, "memory": memory_rig}


@pytest.fixture(params=sorted(RIGS))
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    with RIGS[request.param]() as found:
        yield found


class Heard:
    """Received messages, in order."""

    def __init__(self) -> None:
        self.messages: queue.SimpleQueue[Inbound] = queue.SimpleQueue()
        self._began = time.monotonic()

    def next(self, kind: type[T], *, worker: str) -> T:
        """Return the next message of a worker, which is of this kind."""
        deadline = time.monotonic() + PATIENCE
        while True:
            message = self.messages.get(timeout=max(0.0, deadline - time.monotonic()))
            if message.worker == worker:
                assert isinstance(message, kind)
                assert self._began <= message.at <= time.monotonic()
                return message


def listening(rig: Rig) -> Heard:
    heard = Heard()
    rig.transport.start(RUN, heard.messages.put)
    return heard


@contextmanager
def joined(rig: Rig, worker: str, receive: Callable[[Request], None] = lambda _: None) -> Iterator[Uplink]:
    with rig.uplink() as uplink:
        eventually(lambda: [run for _, run in uplink.orchestrators()] == [RUN])
        uplink.join(RUN, worker, receive)
        yield uplink
        uplink.leave()


def eventually(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.005)


def a_state(worker: str, **changes: object) -> WorkerState:
    state = WorkerState(
        protocol=PROTOCOL, version="1", worker=worker, host="h", pid=1, systems={"s": ("d",)}, state="idle"
    )
    return state.model_copy(update=changes)


def a_header(worker: str) -> ResultHeader:
    return ResultHeader(rollout="maximum.0.true.0", attempt=1, worker=worker, outcome="done", sha256="a" * 64)


def a_failure(worker: str, kind: FailureKind | None) -> ResultHeader:
    return ResultHeader(
        rollout="maximum.0.true.0", attempt=1, worker=worker, outcome="failed", error="it raised", kind=kind
    )


def test_a_token_comes_and_goes(rig: Rig) -> None:
    heard = listening(rig)
    with joined(rig, "early"), joined(rig, "w"):
        assert heard.next(Token, worker="w").alive
    assert not heard.next(Token, worker="w").alive


def test_a_worker_that_was_there_before_is_seen(rig: Rig) -> None:
    with rig.uplink() as uplink:
        uplink.join(RUN, "w", lambda _: None)
        heard = listening(rig)
        assert heard.next(Token, worker="w").alive
        uplink.leave()


def test_a_worker_sees_the_orchestrator_and_its_run(rig: Rig) -> None:
    with rig.uplink() as uplink:
        assert uplink.orchestrators() == []
        listening(rig)
        eventually(lambda: len(uplink.orchestrators()) == 1)
        ((_, run),) = uplink.orchestrators()
        assert run == RUN


def test_another_run_is_not_heard(rig: Rig) -> None:
    heard = listening(rig)
    with joined(rig, "w") as uplink:
        assert heard.next(Token, worker="w").alive
        rig.put(keys.state_key("f" * 16, "w"), encode_message(a_state("w")), None)
        uplink.report(a_state("w", progress=7))
        assert heard.next(Heartbeat, worker="w").state.progress == 7


def test_a_heartbeat_arrives_as_it_was_sent(rig: Rig) -> None:
    heard = listening(rig)
    state = a_state("w", state="busy", rollout="sim_gap.12.nominal.3", attempt=4, progress=99)
    with joined(rig, "w") as uplink:
        heard.next(Token, worker="w")
        uplink.report(state)
        assert heard.next(Heartbeat, worker="w").state == state


@pytest.mark.parametrize("size", [0, 100_000, 4_000_000])
def test_a_result_arrives_as_it_was_sent(rig: Rig, size: int) -> None:
    heard = listening(rig)
    payload = bytes(range(250)) * (size // 250)
    with joined(rig, "w") as uplink:
        heard.next(Token, worker="w")
        uplink.deliver(a_header("w"), payload)
        result = heard.next(Result, worker="w")
        assert result.header == a_header("w")
        assert result.payload == payload


@pytest.mark.parametrize("kind", [*get_args(FailureKind), None])
def test_a_failure_arrives_with_its_kind(rig: Rig, kind: FailureKind | None) -> None:
    heard = listening(rig)
    with joined(rig, "w") as uplink:
        heard.next(Token, worker="w")
        uplink.deliver(a_failure("w", kind), b"")
        assert heard.next(Result, worker="w").header == a_failure("w", kind)


def test_a_header_of_an_older_worker_has_no_kind() -> None:
    assert b"kind" not in encode_message(a_failure("w", None))
    assert b"kind" not in encode_message(a_header("w"))


def test_a_request_reaches_its_worker_alone_and_in_order(rig: Rig) -> None:
    heard = listening(rig)
    mine: list[Request] = []
    other: list[Request] = []
    acks = [Ack(rollout="maximum.0.true.0", attempt=number) for number in range(1, 21)]
    cancel = Cancel(rollout="maximum.0.true.0", attempt=1)
    with joined(rig, "w", mine.append), joined(rig, "ww", other.append):
        for worker in ("w", "ww"):
            heard.next(Token, worker=worker)
        for ack in acks:
            rig.transport.send("w", ack)
        rig.transport.send("ww", cancel)
        eventually(lambda: len(mine) == 20 and len(other) == 1)
    assert mine == acks
    assert other == [cancel]


def test_a_worker_that_has_left_gets_nothing(rig: Rig) -> None:
    heard = listening(rig)
    received: list[Request] = []
    other: list[Request] = []
    with joined(rig, "other", other.append):
        heard.next(Token, worker="other")
        with joined(rig, "w", received.append):
            heard.next(Token, worker="w")
        heard.next(Token, worker="w")
        for worker in ("w", "other"):
            rig.transport.send(worker, Ack(rollout="maximum.0.true.0", attempt=1))
        eventually(lambda: other != [])  # sent after it, and on its way as long
    assert received == []


STATE, RESULT = keys.state_key(RUN, "w"), keys.result_key(RUN, "w", "maximum.0.true.0", 1)


@pytest.mark.parametrize(
    ("key", "payload", "attachment"),
    [
        (STATE, b"", None),
        (STATE, b"\xff\xfe", None),
        (STATE, b"{}", None),
        (STATE, b"[" * 10_000, None),
        (STATE, encode_message(a_state("w")).replace(b'"idle"', b'"asleep"'), None),
        (STATE, encode_message(a_state("w", version="v" * 300)), None),
        (STATE, b" " * MAX_MESSAGE + encode_message(a_state("w")), None),
        (RESULT, b"x", None),
        (RESULT, b"x", b""),
        (RESULT, b"x", b"\xff"),
        (RESULT, b"x", encode_message(a_header("w")).replace(b"maximum.0", b"maximum/0")),
        (RESULT, b"x", encode_message(a_header("w")).replace(b":1,", b":0,")),
        (RESULT, b"x", encode_message(a_header("w")) + b" " * MAX_MESSAGE),
        (RESULT, b"x", encode_message(a_header("w")).replace(b'"done"', b'"done","kind":"system"')),
        (RESULT, b"", encode_message(a_failure("w", "system")).replace(b'"system"', b'"moon"')),
        (RESULT, b"x" * 1001, encode_message(a_header("w"))),
    ],
)
def test_garbage_is_told_and_harms_nothing(
    rig: Rig, key: str, payload: bytes, attachment: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (port, inmemory):
        monkeypatch.setattr(module, "MAX_RESULT", 1000)
    heard = listening(rig)
    with joined(rig, "w") as uplink:
        heard.next(Token, worker="w")
        rig.put(key, payload, attachment)
        reason = heard.next(Garbage, worker="w").reason
        assert reason
        assert len(reason) < 300
        assert "\n" not in reason
        uplink.report(a_state("w"))
        heard.next(Heartbeat, worker="w")
        uplink.deliver(a_header("w"), b"x" * 1000)
        heard.next(Result, worker="w")


@pytest.mark.parametrize("payload", [b"", b"\xff", b"{}", b'{"type":"shutdown"}', b" " * MAX_MESSAGE + b"{}"])
def test_a_worker_ignores_garbage(rig: Rig, payload: bytes) -> None:
    heard = listening(rig)
    received: list[Request] = []
    with joined(rig, "w", received.append):
        heard.next(Token, worker="w")
        rig.put(keys.request_key(RUN, "w"), payload, None)
        rig.put(keys.request_key(RUN, "w"), encode_message(Ack(rollout="maximum.0.true.0", attempt=3)), None)
        eventually(lambda: received != [])
    assert received == [Ack(rollout="maximum.0.true.0", attempt=3)]


@pytest.mark.parametrize("kind", sorted(RIGS))
def test_closing_leaves_no_thread(kind: str) -> None:
    before = set(threading.enumerate())
    with ExitStack() as stack:
        found = stack.enter_context(RIGS[kind]())
        heard = listening(found)
        stack.enter_context(joined(found, "w"))
        heard.next(Token, worker="w")
        assert set(threading.enumerate()) > before
    eventually(lambda: set(threading.enumerate()) <= before)
