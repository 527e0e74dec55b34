"""Clients of a live page that keep a connection without use: they are dropped, so that others find a free one."""

import resource
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from perfbound.orchestrator.report.web import server as server_module
from perfbound.orchestrator.report.web.server import Server
from perfbound.orchestrator.run.page.address import Address
from perfbound.orchestrator.run.page.page_access import OPEN, PageAccess, PagePlace, opened
from perfbound.schemas.file.reader import parse_campaign
from tests.campaigns import FOLDER, UNCHECKED
from tests.end_to_end.processes import wait_for
from tests.fakes.inmemory import campaign
from tests.patience import PATIENCE

PROGRESS = 0.3
HEALTH = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
SLOW = {
    "nothing": [],
    "half a request": [HEALTH],
    "half of a second request": [HEALTH + b"\r\n", b"GET "],
    "a request without the end of its body": [HEALTH + b"Content-Length: 1000\r\n\r\n", b"x"],
    "a request without the end of its chunk": [HEALTH + b"Transfer-Encoding: chunked\r\n\r\n", b"5\r\n"],
    "a refused request without the end of its body": [
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n",
        b"x",
    ],
}


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run directory of a finished campaign."""
    directory = tmp_path_factory.mktemp("slow") / "run"
    text = (FOLDER / "test-function.toml").read_bytes()
    campaign(directory, parse_campaign(text, "test", resolution=5, max_tests=3, replicates=2, **UNCHECKED))
    return directory


@pytest.fixture(params=[False, True], ids=["open", "with a token"])
def port(directory: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[int]:
    """The port of a page."""
    monkeypatch.setattr(server_module, "COMPLETE_REQUEST", PROGRESS)
    place = PagePlace(Address.parse("127.0.0.1:0"), with_token=request.param)
    listening, address, access = opened(place, insecure=False)
    assert (access == OPEN) != request.param
    yield from _served(directory, listening, address, access)


def _served(directory: Path, listening: socket.socket, address: Address, access: PageAccess) -> Iterator[int]:
    server = Server(directory, address, print, access)
    thread = threading.Thread(target=server.run, args=([listening],))
    thread.start()
    yield address.port
    server.should_exit = True
    thread.join(PATIENCE)


def ends(client: socket.socket) -> bool:
    """Whether the server closes a connection, of which all is read."""
    try:
        while client.recv(65536):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize("sent", SLOW.values(), ids=list(SLOW))
def test_a_client_that_does_not_go_on_is_dropped(port: int, sent: list[bytes]) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as client:
        for number, each in enumerate(sent):
            if number:
                assert client.recv(65536).startswith(b"HTTP/1.1 ")
            client.sendall(each)
        assert ends(client)


def answer(port: int, request: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as client:
        client.sendall(request + b"Connection: close\r\n\r\n")
        found = b""
        while more := client.recv(65536):
            found += more
        return found


def test_connections_without_a_request_keep_no_probe_out(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """More of them than may be open, by a client that opens each again when it is dropped."""
    monkeypatch.setattr(server_module, "COMPLETE_REQUEST", PATIENCE)
    with ExitStack() as clients:
        for number in range(3 * server_module.MOST_CONNECTIONS):
            client = clients.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE))
            if number % 2:
                client.sendall(b"GET /hea")
            if number % 50 == 0:
                assert answer(port, HEALTH).startswith(b"HTTP/1.1 200 ")
        for _ in range(5):
            assert answer(port, HEALTH).startswith(b"HTTP/1.1 200 ")
            assert not answer(port, HEALTH.replace(b"/healthz", b"/story.json")).startswith(b"HTTP/1.1 503 ")


@pytest.mark.parametrize("port", [False], indirect=True)
def test_requests_under_way_have_a_limit_and_the_probe_is_beside_it(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "MOST_CONNECTIONS", 2)
    with ExitStack() as clients:
        for _ in range(2):
            client = clients.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE))
            client.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert client.recv(65536).startswith(b"HTTP/1.1 200 ")
        refused = answer(port, HEALTH.replace(b"/healthz", b"/story.json"))
        assert refused.startswith(b"HTTP/1.1 503 ")
        assert b"x-content-type-options: nosniff" in refused
        assert b"2 requests are under way" in refused
        assert answer(port, HEALTH).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("port", [False], indirect=True)
def test_a_stream_without_a_change_stays_open(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as client:
        client.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        while b"\n\n" not in client.recv(65536).partition(b"data: ")[2]:
            pass
        client.settimeout(4 * PROGRESS)
        with pytest.raises(TimeoutError):
            ends(client)


@pytest.mark.integration
def test_more_connections_than_files_are_one_line(directory: Path, tmp_path: Path) -> None:
    """The event loop itself would print a traceback for each of them, thousands of times a second."""
    shown = tmp_path / "shown"
    words = [sys.executable, "-m", "perfbound.orchestrator", "web", str(directory), "--web", "127.0.0.1:0"]

    def fewer_files() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (100, 100))

    with (
        shown.open("wb") as file,
        subprocess.Popen(words, stdout=file, stderr=file, preexec_fn=fewer_files) as page,  # noqa: PLW1509
        ExitStack() as clients,
    ):
        try:
            wait_for(lambda: "/\n" in shown.read_text())
            port = int(shown.read_text().rpartition(":")[2].strip("/\n"))
            for _ in range(150):
                clients.enter_context(socket.create_connection(("127.0.0.1", port)))
            wait_for(lambda: shown.read_text().count("\n") > 1)
            clients.close()
            with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as client:
                client.sendall(HEALTH + b"\r\n")
                assert client.recv(65536).startswith(b"HTTP/1.1 200 ")
        finally:
            page.terminate()
    assert shown.read_text().splitlines()[1:] == [
        "more connections than this process may open files; further ones have to wait",
        "perfbound: the live page has ended",
    ]
