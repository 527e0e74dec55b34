"""Routers between orchestrator and workers: what the orchestrator hears of them, and whom they let in."""

import json
import queue
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack

import pytest
import zenoh

from perfbound.orchestrator.fleet.link.router import Router, route
from perfbound.orchestrator.fleet.link.transport import (
    Heartbeat,
    Inbound,
    Linked,
    RouterToken,
    Token,
    ZenohTransport,
    connect_to_router,
)
from perfbound.schemas.errors import LinkError, PerfboundError
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.access import router_rules
from perfbound.schemas.link.configuration import LOCAL, Tls, connect_config
from perfbound.schemas.link.messages import Ack, Request
from perfbound.workers.transport import ZenohUplink, connect
from tests.contract.test_access import certificate  # noqa: F401
from tests.contract.test_transport import RUN, SECRET, T, a_state, eventually, no_lines, no_waiting
from tests.facts import facts
from tests.patience import PATIENCE, patience
from tests.sharing import free_port

pytestmark = pytest.mark.smoke
WORKER = "a-0123abcd"


class Site:
    """Routers, an orchestrator and workers, each of which may come and go."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.heard: queue.SimpleQueue[Inbound] = queue.SimpleQueue()

    def router(
        self, listen: str = LOCAL, *, routers: Sequence[str] = (), secret: bytes = SECRET
    ) -> tuple[Router, ExitStack]:
        """Return a router, and what ends it."""
        ends = self._stack.enter_context(ExitStack())
        opened = ends.enter_context(route([listen], routers, None, insecure=False, secret=secret, access=None))
        return opened, ends

    def orchestrator(self, *endpoints: str) -> ZenohTransport:
        transport = self._stack.enter_context(connect_to_router(endpoints, None, SECRET, no_lines, grace=7.0))
        transport.start(RUN, self.heard.put)
        return transport

    def worker(self, *endpoints: str) -> tuple[ZenohUplink, list[Request]]:
        received: list[Request] = []
        uplink = self._stack.enter_context(connect(endpoints, None, lambda: None, SECRET))
        eventually(lambda: len(uplink.orchestrators()) == 1)
        uplink.join(RUN, WORKER, received.append)
        return uplink, received

    def hear(self, uplink: ZenohUplink) -> None:
        """Wait for a heartbeat of the worker, which repeats it: tokens come back one after the other."""
        late = patience()
        while not late():
            uplink.report(a_state(WORKER))
            time.sleep(0.05)
            while not self.heard.empty():
                if isinstance(self.heard.get(), Heartbeat):
                    return
        raise TimeoutError("no heartbeat comes through")

    def next(self, kind: type[T], *, among: tuple[type[Inbound], ...] = (Token, Linked, RouterToken)) -> T:
        """Return the next message of a kind; others of `among` may come before it."""
        while not isinstance(message := self.heard.get(timeout=PATIENCE), kind):
            assert isinstance(message, among), message
        return message


@pytest.fixture
def site() -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(stack)


def test_a_router_that_is_restarted_is_heard_of_and_its_worker_comes_back(site: Site) -> None:
    """Also where another endpoint that they know never answers."""
    place, nobody = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    _, ends = site.router(place)
    transport = site.orchestrator(nobody, place)
    assert site.next(RouterToken).alive
    uplink, received = site.worker(place, nobody)
    assert site.next(Token).alive
    assert uplink.linked
    ends.close()
    gone: set[type[Inbound]] = set()
    while gone != {Token, RouterToken, Linked}:
        message = site.heard.get(timeout=PATIENCE)
        assert not (message.up if isinstance(message, Linked) else message.alive)  # type: ignore[union-attr]
        assert not isinstance(message, RouterToken | Linked) or message.grace == 7.0
        gone.add(type(message))
    eventually(lambda: not uplink.linked)
    site.router(place)
    back: set[type[Inbound]] = set()
    while back != {Token, RouterToken, Linked}:
        message = site.heard.get(timeout=PATIENCE)
        assert message.up if isinstance(message, Linked) else message.alive  # type: ignore[union-attr]
        back.add(type(message))
    site.hear(uplink)
    transport.send(WORKER, Ack(rollout="maximum.0.true.0", attempt=1))
    eventually(lambda: len(received) == 1)


def test_a_router_that_does_not_answer_ends_a_patience() -> None:
    nobody = f"tcp/127.0.0.1:{free_port()}"
    with (
        pytest.raises(PerfboundError, match=f"no answer from {nobody} yet; check the address"),
        connect_to_router([nobody], None, SECRET, no_lines, patience=0.0),
    ):
        pass


def test_another_router_takes_over(site: Site) -> None:
    first, ends = site.router()
    second, _ = site.router(routers=first.endpoints)
    site.orchestrator(*first.endpoints, *second.endpoints)
    uplink, _ = site.worker(*second.endpoints)
    assert site.next(Token).alive
    ends.close()
    while not (message := site.next(Token)).alive:
        pass  # gone with the link, and there again with the next one
    assert message.worker == WORKER
    site.hear(uplink)


def test_a_router_counts_what_it_is_connected_with(site: Site) -> None:
    first, _ = site.router()
    second, ends = site.router(routers=first.endpoints)
    site.orchestrator(*first.endpoints)
    site.worker(*second.endpoints)
    eventually(lambda: first.connected == "1 other router, 1 orchestrator, 1 worker")
    eventually(lambda: second.connected == first.connected)
    ends.close()
    eventually(lambda: first.connected == "0 other routers, 1 orchestrator, 0 workers")


def test_a_token_without_the_secret_is_no_router(site: Site) -> None:
    """A peer that is let in without it could otherwise keep the orchestrator waiting for workers that are lost."""
    router, _ = site.router()
    site.orchestrator(*router.endpoints)
    assert site.next(RouterToken).alive
    uplink, _ = site.worker(*router.endpoints)
    token = uplink._session.liveliness().declare_token("perfbound/router/1700000000000-0123abcd-00")
    assert site.next(Token).worker == WORKER
    token.undeclare()  # type: ignore[no-untyped-call]
    uplink.leave()
    while (message := site.heard.get(timeout=PATIENCE)) is not None:
        assert isinstance(message, Token)
        if not message.alive:
            break


def test_a_router_does_not_listen_beyond_this_machine_without_certificates() -> None:
    with (
        pytest.raises(PerfboundError, match=r"use a tls/ endpoint .* or add --insecure"),
        route(["tcp/0.0.0.0:0"], [], None, insecure=False, secret=None, access=None),
    ):
        pass


def test_an_endpoint_in_use_is_one_line(site: Site) -> None:
    router, _ = site.router()
    with pytest.raises(PerfboundError, match=facts("--listen : endpoint another port")):
        site.router(router.endpoints[0])


# Certificates


class Guarded(Site):
    """A router with rules for the worker `a`, the orchestrator `lead` and the router `far`."""

    def __init__(self, stack: ExitStack, made: Callable[[str], Tls]) -> None:
        super().__init__(stack)
        self.made = made
        rules = router_rules(["a", "b"], ["lead"], ["far"])
        opened = stack.enter_context(
            route(["tls/127.0.0.1:0"], [], made("here"), insecure=False, secret=None, access=rules)
        )
        self.endpoints = opened.endpoints

    def leads(self, name: str) -> ZenohTransport:
        transport = self._stack.enter_context(connect_to_router(self.endpoints, self.made(name), None, no_lines))
        transport.start(RUN, self.heard.put)
        return transport

    def works(self, name: str, endpoints: Sequence[str] = ()) -> ZenohUplink:
        return self._stack.enter_context(connect(endpoints or self.endpoints, self.made(name), no_waiting))


@pytest.fixture
def guarded(certificate: Callable[[str], Tls]) -> Iterator[Guarded]:  # noqa: F811
    with ExitStack() as stack:
        yield Guarded(stack, certificate)


def test_behind_a_router_a_worker_speaks_in_its_own_name_alone(guarded: Guarded) -> None:
    transport, received = guarded.leads("lead"), list[Request]()
    ours, theirs = guarded.works("a"), guarded.works("b")
    for uplink in (ours, theirs):
        eventually(lambda: len(uplink.orchestrators()) == 1)  # noqa: B023
        orchestrator, _ = uplink.orchestrators()[0]
        eventually(lambda: uplink.by_certificate(orchestrator))  # noqa: B023
    theirs.join(RUN, WORKER, received.append)  # in the name of the other one
    theirs.report(a_state(WORKER, progress=9))
    theirs.leave()
    theirs.join(RUN, "b-0123abcd", received.append)
    assert guarded.next(Token).worker == "b-0123abcd"
    ours.join(RUN, WORKER, received.append)
    assert guarded.next(Token).worker == WORKER
    ours.report(a_state(WORKER))
    assert guarded.next(Heartbeat).state == a_state(WORKER)
    transport.send(WORKER, Ack(rollout="maximum.0.true.0", attempt=1))
    eventually(lambda: len(received) == 1)


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
def test_with_the_certificate_of_a_worker_no_kind_of_node_has_more_rights(guarded: Guarded, mode: str) -> None:
    """The rules are of the certificate: what connects may call itself a router, and speak for all keys."""
    transport, received, read = guarded.leads("lead"), list[Request](), list[str]()
    ours = guarded.works("a")
    eventually(lambda: len(ours.orchestrators()) == 1)
    ours.join(RUN, WORKER, received.append)
    assert guarded.next(Token).worker == WORKER
    config = json.loads(connect_config(guarded.endpoints, guarded.made("b")))
    # A node of mode router listens at a fixed port of its own otherwise, which another one may have.
    config |= {"mode": mode, "listen": {"endpoints": ["tcp/127.0.0.1:0"]}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as hostile:
        tokens = [
            hostile.liveliness().declare_token(key)
            for key in (
                key_expressions.live_router("0-x"),
                key_expressions.live_orchestrator("f" * 16, "0-x"),
                key_expressions.live_worker(RUN, "a-9"),
            )
        ]
        wide = (key_expressions.request_key(RUN, "*"), f"{key_expressions.ROOT}/**", "**")
        subscribers = [
            hostile.declare_subscriber(key, lambda sample: read.append(str(sample.payload.to_string())))
            for key in (key_expressions.state_key(RUN, "*"), *wide)
        ]
        for key in (
            key_expressions.state_key(RUN, WORKER),
            key_expressions.state_key(RUN, "*"),
            key_expressions.request_key(RUN, WORKER),
            *wide,
        ):
            hostile.put(key, "of a stranger")
        ours.report(a_state(WORKER))
        assert guarded.next(Heartbeat).state == a_state(WORKER)
        transport.send(WORKER, Ack(rollout="maximum.0.true.0", attempt=1))
        eventually(lambda: len(received) == 1)
        # What it sends reaches itself, and is all that it reads.
        assert set(read) <= {"of a stranger"}
        assert len(ours.orchestrators()) == 1
        assert guarded.heard.empty()
        del tokens, subscribers


@pytest.mark.parametrize("name", ["a", "stranger"])
def test_only_a_named_orchestrator_is_seen(guarded: Guarded, name: str) -> None:
    guarded.leads(name)
    guarded.leads("lead")
    uplink = guarded.works("b")
    eventually(lambda: len(uplink.orchestrators()) == 1)
    uplink.join(RUN, "b-0123abcd", lambda _: None)
    assert guarded.next(Token).worker == "b-0123abcd"
    assert len(uplink.orchestrators()) == 1


def test_local_workers_of_an_orchestrator_behind_a_router_show_its_certificate(guarded: Guarded) -> None:
    guarded.leads("lead")
    uplink = guarded.works("lead")
    eventually(lambda: len(uplink.orchestrators()) == 1)
    uplink.join(RUN, "local-1-0123abcd", lambda _: None)
    assert guarded.next(Token).worker == "local-1-0123abcd"


def test_a_named_router_brings_its_workers(guarded: Guarded) -> None:
    guarded.leads("lead")
    far = guarded._stack.enter_context(
        route(
            ["tls/127.0.0.1:0"],
            guarded.endpoints,
            guarded.made("far"),
            insecure=False,
            secret=None,
            access=router_rules(["c"], [], ["here"]),
        )
    )
    uplink = guarded.works("c", far.endpoints)
    eventually(lambda: len(uplink.orchestrators()) == 1)
    uplink.join(RUN, "c-0123abcd", lambda _: None)
    assert guarded.next(Token).worker == "c-0123abcd"
    uplink.report(a_state("c-0123abcd"))
    assert guarded.next(Heartbeat).worker == "c-0123abcd"


def test_a_name_is_of_one_kind() -> None:
    with pytest.raises(LinkError, match="a: named twice"):
        router_rules(["a"], ["a"], [])
    with pytest.raises(LinkError, match="b: named twice"):
        router_rules([], ["b"], ["b"])
    assert router_rules([], [], []) is None
