"""The live page on the real parts: processes, sockets, a browser; and what kills them."""

import json
import signal
import socket
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

import psutil
import pytest
from playwright.sync_api import Browser

from tests.end_to_end import processes
from tests.end_to_end.processes import Process, Processes, contents, of_run, wait_for, write_campaign
from tests.end_to_end.report import browser as chromium
from tests.patience import PATIENCE
from tests.sharing import free_port

browser = chromium.browser
TESTS = 20
SHOWN = "page.report.problems.reduce((sum, each) => sum + each.tests.test.length, 0)"
STATE = "page.report.state"
"""Tests and state that the page shows. Its policy forbids the evaluation of a text in it, so the tests poll."""


def write(folder: Path) -> Path:
    """Write a campaign that lasts a while."""
    return write_campaign(folder / "c.toml", max_tests=str(TESTS), resolution="11")


@pytest.fixture(scope="module")
def pageless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run directory of the campaign, run without a page."""
    folder = tmp_path_factory.mktemp("pageless")
    with processes.processes(folder) as found:
        ended = found.run("perfbound", "run", write(folder), "--out", folder / "run")
    assert ended.code == 0, ended.err
    return folder / "run"


def get(url: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    try:
        with urlopen(Request(url, method=method, headers=headers), timeout=PATIENCE) as answer:
            return answer.status, answer.read()
    except HTTPError as error:
        with error:
            return error.code, error.read()


def story(url: str) -> Any:
    status, body = get(f"{url}story.json")
    assert status == 200, body
    return json.loads(body)


def url_of(process: Process) -> str:
    """Return the address of the page from the output of a process."""
    wait_for(lambda: "live page: " in process.err or not process.running)
    return next(line.removeprefix("live page: ") for line in process.err.splitlines() if line.startswith("live page: "))


def child_of(process: Process) -> psutil.Process:
    (found,) = process.children_with("perfbound.orchestrator.report.web.process")
    return found


def test_a_page_lives_through_the_death_of_its_orchestrator(
    started: Processes, pageless: Path, browser: Browser
) -> None:
    directory, address = started.folder / "run", f"127.0.0.1:{free_port()}"
    campaign = write(started.folder)
    process = started.start("perfbound", "run", campaign, "--out", directory, "--web", address)
    assert url_of(process) == f"http://{address}/"
    with chromium.watched(browser) as watch:
        watch.page.goto(f"http://{address}/")
        watch.shown()
        first = watch.page.evaluate(SHOWN)
        wait_for(lambda: watch.page.evaluate(SHOWN) > first)
        assert watch.errors == []
        assert not (directory / "certificate.json").exists(), "it runs still"
        page = child_of(process)
        process.popen.kill()
        page.wait(PATIENCE)
        assert of_run(directory) == []
        stopped = watch.page.evaluate(SHOWN)
        resumed = started.start("perfbound", "resume", directory, "--workers", "2", "--web", address)
        wait_for(lambda: watch.page.evaluate(SHOWN) > stopped)
        wait_for(lambda: watch.page.evaluate(STATE) == "finished")
        assert watch.page.evaluate(SHOWN) == 2 * TESTS
        ended = resumed.wait()
        assert [error for error in watch.errors if "net::ERR_" not in error] == [], (
            "except for the time without a server"
        )
        assert {each.partition("?")[0] for each in watch.requests} <= {
            f"http://{address}/{path}" for path in ("", "events", "scene")
        } | {"data:,"}
    assert ended.code == 0
    assert f"the live page has ended with the run; `perfbound web {directory}` shows it again" in ended.err
    assert (directory / "certificate.json").read_bytes() == (pageless / "certificate.json").read_bytes()
    assert of_run(directory) == []


def test_a_page_that_is_killed_does_not_disturb_the_run(started: Processes, pageless: Path) -> None:
    directory = started.folder / "run"
    campaign = write(started.folder)
    process = started.start("perfbound", "run", campaign, "--out", directory, "--web", "--log", "json")
    wait_for(lambda: "live page: " in process.err)
    said = [json.loads(line)["message"] for line in process.err.splitlines()]
    url = next(each for each in said if each.startswith("live page: ")).removeprefix("live page: ")
    told = story(url)
    assert told["state"] == "running"
    wait_for(lambda: {worker["state"] for worker in story(url)["workers"]} & {"idle", "busy"})
    assert all(worker["heartbeat"] is not None for worker in story(url)["workers"])
    child_of(process).kill()
    ended = process.wait()
    assert ended.code == 0
    lines = [json.loads(line)["message"] for line in ended.err.splitlines()]
    assert [line for line in lines if "has ended" in line] == [
        f"the live page has ended: signal 9. The campaign continues; `perfbound web {directory}` shows it"
    ]
    assert (directory / "certificate.json").read_bytes() == (pageless / "certificate.json").read_bytes()
    assert of_run(directory) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_stopped_takes_its_page_along(started: Processes, number: int) -> None:
    directory = started.folder / "run"
    process = started.start("perfbound", "orchestrate", write(started.folder), "--out", directory, "--web")
    url = url_of(process)
    assert story(url)["state"] == "running"
    process.popen.send_signal(number)
    ended = process.wait()
    assert ended.code == 128 + number
    assert ended.err.endswith(f"perfbound: stopped; continue with: perfbound resume {directory}\n")
    assert of_run(directory) == []


def test_a_port_that_is_taken_is_said_before_anything_is_started(started: Processes) -> None:
    directory = started.folder / "run"
    campaign = write(started.folder)
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = f"127.0.0.1:{other.getsockname()[1]}"
        ended = started.run("perfbound", "run", campaign, "--out", directory, "--web", address)
    assert ended.code == 1
    assert ended.fault == f"perfbound: --web {address}: this port is in use; choose another, or 0 for a free one"
    assert not directory.exists()
    for bad, text in (("0.0.0.0:0", "add --insecure"), ("nowhere.invalid:0", "cannot listen there")):
        ended = started.run("perfbound", "run", campaign, "--out", directory, "--web", bad)
        assert (ended.code, text in ended.fault) == (1, True)
        assert not directory.exists()
    ended = started.run("perfbound", "run", "--web", campaign, "--out", directory)
    assert ended.code == 2
    assert "is not HOST:PORT" in ended.err


@pytest.mark.journey
def test_the_page_of_a_finished_campaign(started: Processes, pageless: Path, browser: Browser) -> None:
    before = contents(pageless)
    process = started.start("perfbound", "web", pageless)
    url = url_of(process)
    with chromium.watched(browser) as watch:
        watch.page.goto(url)
        watch.shown()
        assert watch.page.evaluate(STATE) == "finished"
        assert watch.errors == []
        assert all(each.startswith((url, "data:")) for each in watch.requests)
    told = story(url)
    path = told["scenes"][0]["rollouts"][0]["path"]
    assert get(url + path) == (200, (pageless / path).read_bytes())
    assert get(f"{url}certificate.json") == (200, (pageless / "certificate.json").read_bytes())
    assert get(url, "HEAD") == (200, b"")
    assert get(f"{url}events", "HEAD") == (200, b"")
    assert get(url, "POST")[0] == 405
    assert get(f"{url}story.json", Host="evil.example")[0] == 400
    assert get(f"{url}trajectories/..%2Fcampaign.db")[0] == 404
    process.popen.send_signal(signal.SIGTERM)
    ended = process.wait()
    assert (ended.code, ended.out) == (143, "")
    assert ended.err == f"live page: {url}\nperfbound: the live page has ended\n"
    assert contents(pageless) == before


def raw(url: str, text: bytes) -> socket.socket:
    host, port = url.removeprefix("http://").rstrip("/").split(":")
    client = socket.create_connection((host, int(port)), timeout=PATIENCE)
    client.sendall(text)
    return client


def answer_to(url: str, text: bytes) -> bytes:
    with raw(url, text) as client:
        found = b""
        while more := client.recv(65536):
            found += more
        return found


def test_hostile_clients(started: Processes, pageless: Path) -> None:
    """They are answered or dropped, and the page stays there for others; no internal detail is sent."""
    process = started.start("perfbound", "web", pageless)
    url = url_of(process)
    wait_for(lambda: _answers(url))
    host = b"Host: localhost\r\n"
    for text, status in {
        b"GET / HTTP/1.1\r\n\r\n": b"400",
        b"GET / HTTP/1.0\r\n\r\n": b"400",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n": b"400",
        b"GET http://localhost/ HTTP/1.1\r\nHost: evil.example\r\n\r\n": b"400",
        b"GET /trajectories/../campaign.db HTTP/1.1\r\nConnection: close\r\n" + host + b"\r\n": b"404",
        b"GET /trajectories/%2e%2e/campaign.db HTTP/1.1\r\nConnection: close\r\n" + host + b"\r\n": b"404",
        b"GET /%00 HTTP/1.1\r\nConnection: close\r\n" + host + b"\r\n": b"404",
        b"GET /" + b"a" * 2000 + b" HTTP/1.1\r\nConnection: close\r\n" + host + b"\r\n": b"414",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n": b"400",
    }.items():
        answer = answer_to(url, text)
        assert answer.startswith(b"HTTP/1.1 " + status), (text[:60], answer[:200])
        assert b"server:" not in answer.lower()
    with raw(url, b"GET / HTTP/1.1\r\n" + host + b"X: " + b"a" * 100_000) as client, suppress(ConnectionResetError):
        assert client.recv(12) in (b"", b"HTTP/1.1 400")
    with ExitStack() as clients:
        for _ in range(40):  # they ask for all events, and take none
            clients.enter_context(raw(url, b"GET /events HTTP/1.1\r\n" + host + b"\r\n"))
        for _ in range(40):  # they ask nothing
            clients.enter_context(raw(url, b"GET / HT"))
        assert story(url)["state"] == "finished"
        assert get(f"{url}events")[0] == 503
    wait_for(lambda: get(f"{url}events", "HEAD")[0] == 200)
    process.popen.send_signal(signal.SIGINT)
    ended = process.wait()
    assert (ended.code, "Traceback" in ended.err) == (130, False)


def _answers(url: str) -> bool:
    try:
        return get(url)[0] == 200
    except (URLError, OSError):
        return False
