"""The page of a run, from the side of the orchestrator: address, feed, and isolation of its faults."""

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from perfbound.orchestrator.run.page import live_page as live
from perfbound.orchestrator.run.page.address import Address, bind
from perfbound.orchestrator.run.page.live_page import LivePage, live_page
from perfbound.orchestrator.run.page.page_access import PagePlace
from perfbound.orchestrator.run.page.page_feed import message, read_message
from perfbound.orchestrator.run.service import RunStatus
from perfbound.schemas.errors import PerfboundError
from tests.campaigns import config
from tests.facts import facts, says
from tests.fakes.inmemory import Log, campaign
from tests.patience import PATIENCE

BEGAN = time.time()


@pytest.mark.parametrize(
    ("text", "address", "url"),
    [
        ("127.0.0.1:80", Address("127.0.0.1", 80), "http://127.0.0.1:80/"),
        ("8000", Address("127.0.0.1", 8000), "http://127.0.0.1:8000/"),
        ("[::1]:0", Address("::1", 0), "http://[::1]:0/"),
        ("lab-1.example:65535", Address("lab-1.example", 65535), "http://lab-1.example:65535/"),
        ("0.0.0.0:80", Address("0.0.0.0", 80), f"http://{os.uname().nodename}:80/"),
    ],
)
def test_an_address(text: str, address: Address, url: str) -> None:
    assert Address.parse(text) == address
    assert Address.parse(str(address)) == address
    assert address.url == url


@pytest.mark.parametrize("text", ["", "localhost", "host:", "host:65536", "host:-1", "::1:80", "a b:80", "http://a:80"])
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(ValueError, match="is not HOST:PORT"):
        Address.parse(text)


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_others_are_let_in_only_when_that_is_said(host: str) -> None:
    if host == "::" and not socket.has_dualstack_ipv6():
        pytest.skip("switch on IPv6: sysctl net.ipv6.conf.all.disable_ipv6=0")
    with pytest.raises(PerfboundError, match=facts("address --insecure")):
        bind(Address(host), insecure=False)
    listening, address = bind(Address(host), insecure=True)
    with listening:
        assert address.port > 0


@pytest.mark.integration
def test_a_port_that_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perfbound.orchestrator.run.page.address.PATIENCE", 0.1)
    first, address = bind(Address(), insecure=False)
    with first, pytest.raises(PerfboundError, match=facts("port another 0")):
        bind(address, insecure=False)


@pytest.mark.parametrize("host", ["nowhere.invalid", "192.0.2.1", "." * 300])
def test_a_host_that_is_not_here(host: str) -> None:
    with pytest.raises(PerfboundError, match=facts("address")):
        bind(Address(host), insecure=True)


@pytest.fixture(scope="module")
def looks(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Messages to the page of a short campaign, one per status."""
    found: list[bytes] = []
    chosen = config("test-function", resolution=5, max_tests=5)
    campaign(tmp_path_factory.mktemp("feed") / "run", chosen, log=_Told(found))
    return found


class _Told(Log):
    def __init__(self, found: list[bytes]) -> None:
        super().__init__()
        self._found = found

    def show(self, status: RunStatus) -> None:
        self._found.append(message(status))


def test_the_page_is_told_what_workers_do(looks: list[bytes]) -> None:
    workers = [read_message(look).workers for look in looks]
    assert workers[0] == {}
    (told,) = {name: known for look in workers for name, known in look.items()}.items()
    name, (state, rollout, heartbeat) = told
    assert name.startswith("worker-0")
    assert state in ("new", "idle", "busy")
    assert rollout is None or rollout.startswith("maximum.")
    assert heartbeat is not None
    assert BEGAN <= heartbeat <= time.time()


@pytest.fixture
def status(monkeypatch: pytest.MonkeyPatch) -> RunStatus:
    """No workers; shown as often as asked."""
    monkeypatch.setattr(live, "PERIOD", 0.0)
    return RunStatus(config("test-function"), {}, {}, {}, {}, 0, 0, 0.0)


def said(page: LivePage) -> list[str]:
    """Return what a page has printed so far."""
    stream = page._console.file
    assert isinstance(stream, StringIO)
    return stream.getvalue().splitlines()[1:]  # after its address


Opened = Callable[[str], AbstractContextManager[LivePage]]


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Opened:
    """Open a page that is served by a shell script."""
    monkeypatch.setattr(live, "GRACE", 0.1)
    program = tmp_path / "child"
    monkeypatch.setattr("sys.executable", str(program))

    @contextmanager
    def page(script: str) -> Iterator[LivePage]:
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        with live_page(PagePlace(), tmp_path / "run", Console(file=StringIO()), insecure=False) as found:
            yield found

    return page


@pytest.mark.integration
def test_a_child_that_takes_nothing_holds_nothing_up(
    opened: Opened, status: RunStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "message", lambda _: b"x" * 50_000)
    with opened("exec sleep infinity") as page:
        page.announce()
        for _ in range(100):
            page.show(status)
        assert said(page) == []


@pytest.mark.integration
def test_a_child_that_ends_is_said_once(opened: Opened, status: RunStatus, tmp_path: Path) -> None:
    with opened("echo something is wrong >&2; exit 3") as page:
        page.announce()
        while not any("has ended" in line for line in said(page)):
            page.show(status)
            time.sleep(0.01)
        lines = said(page)
        (ended,) = [line for line in lines if "has ended" in line]
        assert ended.startswith("the live page has ended: exit code 3")
        assert says(ended, f"`perfbound web {tmp_path / 'run'}`")
        assert "something is wrong" in "\n".join(lines)
        page.show(status)
        assert said(page) == lines


@pytest.mark.integration
def test_whatever_cannot_be_told_is_no_end_of_a_run(
    opened: Opened, status: RunStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "message", lambda _: b"x" * 10_000_000)
    with opened("exec sleep infinity") as page:
        page.announce()
        page.show(status)
        (line,) = said(page)
        assert line.startswith("the live page has ended: [Errno ")
        page.show(status)
        assert said(page) == [line]


@pytest.mark.integration
def test_of_a_page_that_was_not_announced_nothing_is_said(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its run has not begun: the fault is its only line, and comes at once."""
    monkeypatch.setattr(live, "GRACE", PATIENCE)
    began = time.monotonic()
    with opened("exec sleep infinity") as page:
        pass
    assert page._console.file.getvalue() == ""  # type: ignore[attr-defined]
    assert time.monotonic() - began < PATIENCE


def test_without_an_address_there_is_no_page(tmp_path: Path, status: RunStatus) -> None:
    console = Console(file=StringIO())
    with live_page(None, tmp_path, console, insecure=False) as page:
        page.announce()
        page.show(status)
    assert console.file.getvalue() == ""  # type: ignore[attr-defined]
