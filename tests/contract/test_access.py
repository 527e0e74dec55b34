"""Access rules with real certificates: a worker speaks and reads in its own name alone."""

import queue
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
import trustme
import zenoh

from perfbound.orchestrator.fleet.link.transport import Heartbeat, Inbound, Result, Token, ZenohTransport, listen
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.access import access_rules
from perfbound.schemas.link.configuration import Tls, connect_config
from perfbound.schemas.link.ends import takes_by_certificate
from perfbound.schemas.link.messages import Ack, Request, encode_message
from perfbound.workers.transport import ZenohUplink, connect
from tests.contract.test_transport import RUN, T, a_header, a_state, eventually, no_waiting
from tests.patience import PATIENCE

A, B = "a-0123abcd", "b-0123abcd"


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Tls]:
    """A maker of certificates of one authority; each has a common name."""
    authority, folder = trustme.CA(), tmp_path_factory.mktemp("tls")
    authority.cert_pem.write_to_path(folder / "ca.pem")

    def made(name: str) -> Tls:
        issued, paths = authority.issue_cert("127.0.0.1", common_name=name), [folder / f"{name}.{end}" for end in "ck"]
        issued.cert_chain_pems[0].write_to_path(paths[0])
        issued.private_key_pem.write_to_path(paths[1])
        paths[1].chmod(0o600)
        return Tls(ca=str(folder / "ca.pem"), certificate=str(paths[0]), key=str(paths[1]))

    return made


class Site:
    """An orchestrator that takes the workers `a` and `b`, what it receives, and a way for workers to connect."""

    def __init__(self, stack: ExitStack, certificate: Callable[[str], Tls]) -> None:
        self._stack, self._certificate = stack, certificate
        rules = access_rules(["a", "b"], "server")
        self.transport: ZenohTransport = stack.enter_context(
            listen("tls/127.0.0.1:0", certificate("server"), access=rules)
        )
        self.heard: queue.SimpleQueue[Inbound] = queue.SimpleQueue()
        self.transport.start(RUN, self.heard.put)

    def uplink(self, name: str) -> ZenohUplink:
        return self._stack.enter_context(connect([self.transport.endpoint], self._certificate(name), no_waiting))

    def joined(self, name: str, worker: str) -> tuple[ZenohUplink, list[Request]]:
        received: list[Request] = []
        uplink = self.uplink(name)
        eventually(lambda: len(uplink.orchestrators()) == 1)
        uplink.join(RUN, worker, received.append)
        return uplink, received

    def raw(self, name: str) -> zenoh.Session:
        config = connect_config([self.transport.endpoint], self._certificate(name))
        session = zenoh.open(zenoh.Config.from_json5(config))
        self._stack.callback(session.close)
        return session

    def next(self, kind: type[T]) -> T:
        message = self.heard.get(timeout=PATIENCE)
        assert isinstance(message, kind), message
        return message


@pytest.fixture
def site(certificate: Callable[[str], Tls]) -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(stack, certificate)


def test_a_worker_speaks_in_its_own_name_alone(site: Site) -> None:
    assert takes_by_certificate(site.transport.end.name)
    ours, requests = site.joined("a", A)
    assert site.next(Token).worker == A
    # In the name of the other one: its token, its heartbeats and results, and what reads its requests.
    theirs, stolen = site.joined("b", A)
    theirs.report(a_state(A, progress=9))
    theirs.deliver(a_header(A), b"forged")
    theirs.leave()
    theirs.join(RUN, B, stolen.append)
    assert site.next(Token).worker == B
    theirs.report(a_state(B))
    assert site.next(Heartbeat).worker == B
    ours.report(a_state(A))
    assert site.next(Heartbeat).state == a_state(A)
    ours.deliver(a_header(A), b"mine")
    assert site.next(Result).payload == b"mine"
    for worker in (A, B):
        site.transport.send(worker, Ack(rollout="maximum.0.true.0", attempt=1))
    eventually(lambda: len(requests) == len(stolen) == 1)
    ours.leave()
    gone = site.next(Token)
    assert (gone.worker, gone.alive) == (A, False)


def test_a_worker_reads_no_requests_of_another_one_and_sends_none(site: Site) -> None:
    ours, requests = site.joined("a", A)
    assert site.next(Token).worker == A
    spy, forger, read = site.raw("b"), site.raw("b"), []
    for expression in (
        key_expressions.request_key(RUN, A),
        key_expressions.request_key(RUN, "*"),
        f"perfbound/{RUN}/**",
        "**",
    ):
        spy.declare_subscriber(expression, lambda sample: read.append(str(sample.key_expr)))
    token = forger.liveliness().declare_token(key_expressions.live_orchestrator("f" * 16, "0-stranger"))
    order = Ack(rollout="maximum.0.true.0", attempt=1)
    packet = site.transport.end.request(A, order)
    for key in (packet.key, key_expressions.request_key(RUN, "*"), key_expressions.request_key("*", "*")):
        forger.put(key, packet.payload, attachment=packet.attachment)
    ours.report(a_state(A))
    assert site.next(Heartbeat).worker == A
    site.transport.send(A, Ack(rollout="maximum.0.true.0", attempt=2))
    eventually(lambda: len(requests) == 1)
    assert requests == [Ack(rollout="maximum.0.true.0", attempt=2)]
    assert read == []
    assert len(ours.orchestrators()) == 1
    assert not ours.strangers
    del token


def test_a_certificate_that_is_not_listed_sees_and_says_nothing(site: Site) -> None:
    stranger = site.uplink("c")
    stranger._end.appear(key_expressions.live_orchestrator(RUN, site.transport.end.name))
    stranger.join(RUN, "c-0123abcd", lambda _: None)
    stranger.report(a_state("c-0123abcd"))
    session = site.raw("c")
    for key in (
        key_expressions.state_key(RUN, "c-0123abcd"),
        key_expressions.state_key(RUN, A),
        key_expressions.state_key(RUN, "*"),
    ):
        session.put(key, encode_message(a_state(A)))
    ours, _ = site.joined("a", A)
    assert site.next(Token).worker == A
    ours.report(a_state(A))
    assert site.next(Heartbeat).worker == A
    assert site.heard.empty()
    assert not site.uplink("c").orchestrators()


def test_local_workers_show_the_certificate_of_the_orchestrator(site: Site) -> None:
    uplink, requests = site.joined("server", "local-1-0123abcd")
    assert site.next(Token).worker == "local-1-0123abcd"
    uplink.report(a_state("local-1-0123abcd"))
    assert site.next(Heartbeat).worker == "local-1-0123abcd"
    site.transport.send("local-1-0123abcd", Ack(rollout="maximum.0.true.0", attempt=1))
    eventually(lambda: len(requests) == 1)
