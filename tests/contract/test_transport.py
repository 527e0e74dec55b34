"""The contract of both transports: Zenoh on loopback, and the one in memory."""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

import pytest
import zenoh

from perfbound.orchestrator.fleet.link import transport as port
from perfbound.orchestrator.fleet.link.router import route
from perfbound.orchestrator.fleet.link.transport import (
    Garbage,
    Heartbeat,
    Inbound,
    Result,
    Token,
    Transport,
    ZenohTransport,
    connect_to_router,
    listen,
)
from perfbound.schemas.failure import FailureKind
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.configuration import LOCAL, connect_config
from perfbound.schemas.link.ends import SHOWN, OrchestratorEnd
from perfbound.schemas.link.messages import (
    MAX_MESSAGE,
    PROTOCOL,
    Ack,
    Cancel,
    Request,
    ResultHeader,
    WorkerState,
    encode_message,
)
from perfbound.workers.transport import Uplink, ZenohUplink, connect
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


SECRET = b"a secret of the tests"


@contextmanager
def zenoh_rig() -> Iterator[Rig]:
    with listen(LOCAL, secret=SECRET) as transport:
        raw = zenoh.open(zenoh.Config.from_json5(connect_config([transport.endpoint], None, SECRET)))
        try:
            block = zenoh.CongestionControl.BLOCK
            yield Rig(
                transport,
                lambda: connect([transport.endpoint], None, no_waiting, SECRET),
                lambda key, payload, header: raw.put(key, payload, attachment=header, congestion_control=block),
            )
        finally:
            raw.close()  # type: ignore[no-untyped-call]


@contextmanager
def router_rig() -> Iterator[Rig]:
    """As the other one, but that orchestrator and workers connect to a router, and what is put comes from a third."""
    with ExitStack() as stack:
        router = stack.enter_context(route([LOCAL], [], None, insecure=False, secret=SECRET, access=None))
        other = stack.enter_context(route([LOCAL], router.endpoints, None, insecure=False, secret=SECRET, access=None))
        transport = stack.enter_context(connect_to_router(router.endpoints, None, SECRET, no_lines))
        raw = zenoh.open(zenoh.Config.from_json5(connect_config(other.endpoints, None, SECRET)))
        stack.callback(raw.close)
        block = zenoh.CongestionControl.BLOCK
        yield Rig(
            transport,
            lambda: connect(other.endpoints, None, no_waiting, SECRET),
            lambda key, payload, header: raw.put(key, payload, attachment=header, congestion_control=block),
        )


def no_lines(line: str) -> None:
    raise AssertionError(line)


@contextmanager
def memory_rig() -> Iterator[Rig]:
    @contextmanager
    def uplink() -> Iterator[Uplink]:
        joined = InMemoryUplink(network)
        yield joined
        joined.leave()

    with Network(secret=SECRET) as network:
        transport = InMemoryTransport(network)
        yield Rig(transport, uplink, network.put)
        transport.stop()


RIGS = {"zenoh": zenoh_rig, "two routers": router_rig, "memory": memory_rig}


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
            if getattr(message, "worker", None) == worker:
                assert isinstance(message, kind)
                assert self._began <= message.at <= time.monotonic()
                return message


def end_of(rig: Rig) -> OrchestratorEnd:
    assert isinstance(rig.transport, ZenohTransport | InMemoryTransport)
    return rig.transport.end


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


def sealed(uplink: Uplink, stream: Literal["state", "result"], payload: bytes, header: bytes | None) -> bytes | None:
    """Return the attachment that this worker would make for anything."""
    assert isinstance(uplink, ZenohUplink | InMemoryUplink)
    line = uplink._end._line
    assert line is not None
    if stream == "state":
        return line.states.seal("w", payload)
    return None if header is None else line.results.seal("w", header) + header


def eventually(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.005)


def a_state(worker: str, **changes: object) -> WorkerState:
    state = WorkerState(
        protocol=PROTOCOL, version="1", worker=worker, host="h", pid=1, systems={"s": "d" * 64}, state="idle"
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
        rig.put(key_expressions.state_key("f" * 16, "w"), encode_message(a_state("w")), None)
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


STATE, RESULT = key_expressions.state_key(RUN, "w"), key_expressions.result_key(RUN, "w", "maximum.0.true.0", 1)


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
        rig.put(key, payload, sealed(uplink, "state" if key == STATE else "result", payload, attachment))
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
        rig.put(key_expressions.request_key(RUN, "w"), payload, end_of(rig)._requests.seal("w", payload))
        rig.put(*end_of(rig).request("w", Ack(rollout="maximum.0.true.0", attempt=3)))
        eventually(lambda: received != [])
    assert received == [Ack(rollout="maximum.0.true.0", attempt=3)]


ACK = encode_message(Ack(rollout="maximum.0.true.0", attempt=9))


def test_a_worker_obeys_its_orchestrator_alone(rig: Rig) -> None:
    """Neither a peer without the secret, nor what was said to another worker, nor what was said before."""
    heard = listening(rig)
    received: list[Request] = []
    last = Ack(rollout="maximum.0.true.0", attempt=3)
    with joined(rig, "w", received.append):
        heard.next(Token, worker="w")
        key, other = (
            key_expressions.request_key(RUN, "w"),
            end_of(rig).request("v", Ack(rollout="maximum.0.true.0", attempt=1)),
        )
        said = end_of(rig).request("w", Ack(rollout="maximum.0.true.0", attempt=2))
        foreign = OrchestratorEnd(b"another secret of a stranger", RUN).request("w", last)
        earlier = OrchestratorEnd(SECRET, RUN).request("w", last)
        for payload, attachment in (
            *((ACK, None), (ACK, b""), (ACK, bytes(40)), (ACK, said.attachment)),
            *((other.payload, other.attachment), (foreign.payload, foreign.attachment)),
            *((earlier.payload, earlier.attachment), (said.payload, said.attachment), (said.payload, said.attachment)),
        ):
            rig.put(key, payload, attachment)
        eventually(lambda: received != [])  # what another session puts may come later than what this one sends
        rig.transport.send("w", last)
        eventually(lambda: last in received)
    assert received == [Ack(rollout="maximum.0.true.0", attempt=2), last]


def test_a_message_without_the_secret_is_none(rig: Rig) -> None:
    heard = listening(rig)
    state = encode_message(a_state("w", progress=9))
    header = encode_message(a_header("w"))
    with joined(rig, "w") as uplink:
        heard.next(Token, worker="w")
        own = sealed(uplink, "result", b"", header)
        assert own is not None
        altered = header.replace(b"maximum.0", b"maximum.1")
        for attachment in (None, b"", header, bytes(40) + header, own[:40] + altered, own[:39]):
            rig.put(RESULT, b"x", attachment)
        for number in range(SHOWN):
            reason = heard.next(Garbage, worker="w").reason
            assert reason.endswith("; further ones are not reported") == (number == SHOWN - 1)
        for attachment in (None, b"", bytes(40), own[:40], sealed(uplink, "state", b"{}", None)):
            rig.put(STATE, state, attachment)
        rig.put(RESULT, b"x", own)
        rig.put(RESULT, b"x", own)
        assert heard.next(Result, worker="w").payload == b"x"
        uplink.deliver(a_header("w"), b"y")
        assert heard.next(Result, worker="w").payload == b"y"
        uplink.report(a_state("w", progress=7))
        assert heard.next(Heartbeat, worker="w").state.progress == 7


def test_an_orchestrator_without_the_secret_is_a_stranger(rig: Rig) -> None:
    forged = OrchestratorEnd(b"another secret of a stranger", RUN).name
    with rig.uplink() as uplink:
        assert isinstance(uplink, ZenohUplink | InMemoryUplink)
        end = uplink._end
        end.appear(key_expressions.live_orchestrator(RUN, forged))
        assert end.strangers
        assert uplink.orchestrators() == []
        listening(rig)
        eventually(lambda: len(uplink.orchestrators()) == 1)
        # One that was announced for another run does not count in this one.
        ((name, _),) = uplink.orchestrators()
        end.appear(key_expressions.live_orchestrator("f" * 16, name))
        assert [run for _, run in uplink.orchestrators()] == [RUN]


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
