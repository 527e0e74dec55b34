"""The live page as a web application, called directly: access, routes and events."""

import asyncio
import json
import os
import shutil
import signal
import socket
import sqlite3
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.data.page import ReportData
from perfbound.orchestrator.report.data.rollouts import RolloutsOfTest
from perfbound.orchestrator.report.web import app, process
from perfbound.orchestrator.report.web import snapshots as snapshots_module
from perfbound.orchestrator.report.web.server import Server
from perfbound.orchestrator.report.web.snapshots import SnapshotCache
from perfbound.orchestrator.run.page.address import Address
from perfbound.orchestrator.run.page.page_feed import LiveState, RunFigures
from perfbound.orchestrator.run.routers import RouterLink
from perfbound.orchestrator.store.commit_times import CommitTimes
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import JournalError
from perfbound.schemas.file.reader import parse_campaign
from tests.campaigns import FOLDER, UNCHECKED
from tests.facts import says
from tests.fakes.inmemory import campaign
from tests.patience import PATIENCE

RECORDED = "trajectories/maximum/0/maximum.0.true.0.mcap"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run directory of a finished campaign."""
    directory = tmp_path_factory.mktemp("web") / "run"
    text = (FOLDER / "test-function.toml").read_bytes()
    campaign(directory, parse_campaign(text, "test", resolution=5, max_tests=3, replicates=2, **UNCHECKED))
    return directory


@pytest.fixture
def directory(finished: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots_module, "SHORTEST_PAUSE", 0.01)
    monkeypatch.setattr(snapshots_module, "LONGEST_PAUSE", 0.02)
    monkeypatch.setattr(app, "FIRST_PICTURE", PATIENCE)


@dataclass
class Answer:
    status: int = 0
    headers: dict[str, str] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)

    @property
    def body(self) -> bytes:
        return b"".join(self.chunks)

    @property
    def text(self) -> str:
        return self.body.decode()

    @property
    def stories(self) -> list[Any]:
        """The data in the events of a stream."""
        events = [event for event in self.text.split("\n\n") if event.startswith("event: story\n")]
        return [json.loads(event.partition("\ndata: ")[2]) for event in events]

    async def take(self, message: Mapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            self.headers = {name.decode(): value.decode() for name, value in message["headers"]}
        else:
            self.chunks.append(message["body"])


Send = Callable[[Mapping[str, Any]], Awaitable[None]]
HOST = (("host", "127.0.0.1:8000"),)


def scope(path: str, method: str = "GET", query: str = "", headers: tuple[tuple[str, str], ...] = HOST) -> Any:
    return {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers],
        "root_path": "",
        "client": None,
        "server": None,
    }


class Client:
    """A client of an application in the event loop of the test."""

    def __init__(self, application: Any) -> None:
        self._application = application

    async def ask(self, path: str, **asked: Any) -> Answer:
        answer = Answer()
        await self._application(scope(path, **asked), self._silent, answer.take)
        return answer

    def open(self, send: Send) -> "asyncio.Task[None]":
        """Ask for the events; cancelled when the client goes."""
        return asyncio.get_running_loop().create_task(self._application(scope("/events"), self._silent, send))

    @staticmethod
    async def _silent() -> Any:
        await asyncio.Event().wait()


class Stub(Collector):
    """A collector whose data the test writes."""

    def __init__(self, story: ReportData) -> None:
        super().__init__(Path("nowhere"))
        self.story = story
        self.refreshes = 0
        self.live: Mapping[str, LiveState] | None = None
        self.trouble: Exception | None = None

    def refresh(self, live: Mapping[str, LiveState] | None = None, at: float | None = None) -> ReportData:
        self.refreshes += 1
        self.live = live
        if self.trouble is not None:
            raise self.trouble
        return replace(self.story, updated=at)

    def rollouts_of_test(self, problem: str, test: int) -> RolloutsOfTest:
        raise ZeroDivisionError("a fault of ours")


@pytest.fixture
def stub(finished: Path) -> Stub:
    return Stub(Collector(finished).refresh())


def client(directory: Path, address: Address = Address("127.0.0.1", 8000)) -> Client:  # noqa: B008  (frozen)
    return Client(app.application(directory, SnapshotCache(Collector(directory), pytest.fail), address))


def get(directory: Path, path: str, **asked: Any) -> Answer:
    return asyncio.run(client(directory).ask(path, **asked))


def watching(
    stub: Stub, test: Callable[[Client, SnapshotCache], Coroutine[Any, Any, None]], said: list[str] | None = None
) -> None:
    """Run a test with an application that serves the data of the stub."""

    async def whole() -> None:
        snapshots = SnapshotCache(stub, pytest.fail if said is None else said.append)
        application = app.application(Path("nowhere"), snapshots, Address())
        await test(Client(application), snapshots)

    asyncio.run(whole())


async def until(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.005)


async def gone(*streams: "asyncio.Task[None]") -> None:
    for stream in streams:
        stream.cancel()
        with suppress(asyncio.CancelledError):
            await stream


# Access


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost", "LOCALHOST:1", "[::1]:8000"])
def test_the_page_answers_to_its_own_names(finished: Path, host: str) -> None:
    assert get(finished, "/story.json", headers=(("host", host),)).status == 200


@pytest.mark.parametrize(
    "host",
    [
        *("evil.example", "evil.example:8000", "127.0.0.1.evil.example", "localhost.evil.example:80", "192.168.1.7"),
        *("", ":8000", "127.0.0.1@evil.example", "localhost/", "localhost\n", "127.0.0.1:8000:1", "127.1", "[::2]"),
    ],
)
@pytest.mark.parametrize("path", ["/", "/events", "/story.json", f"/{RECORDED}", "/nowhere"])
def test_another_host_is_refused(finished: Path, host: str, path: str) -> None:
    """A web site whose name is changed to resolve to this machine (DNS rebinding) reads nothing."""
    answer = get(finished, path, headers=(("host", host),))
    assert answer.status == 400
    assert b"segway" not in answer.body
    assert b"test-function" not in answer.body


@pytest.mark.parametrize("headers", [(), (("host", "evil.example"), ("host", "localhost"))])
def test_a_request_names_one_host(finished: Path, headers: tuple[tuple[str, str], ...]) -> None:
    """The HTTP parser refuses every second Host header; the end-to-end tests send one."""
    assert get(finished, "/", headers=headers).status == 400


def test_a_page_for_others_answers_to_the_host_in_its_url(finished: Path) -> None:
    def statuses(address: Address, *hosts: str) -> list[int]:
        served = client(finished, address)
        return [asyncio.run(served.ask("/nowhere", headers=(("host", host),))).status for host in hosts]

    everywhere = Address("0.0.0.0", 80)
    assert f"http://{os.uname().nodename}:80/" == everywhere.url
    assert statuses(everywhere, os.uname().nodename, "evil.example", "192.168.1.7") == [404, 400, 400]
    assert statuses(Address("lab.example", 80), "Lab.Example:80", "192.168.1.7") == [404, 400]
    assert statuses(Address("192.168.1.7", 80), "192.168.1.7", "192.168.1.8") == [404, 400]
    assert statuses(Address("fd00::7", 80), "[fd00::7]:80", "[fd00::8]") == [404, 400]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
@pytest.mark.parametrize("path", ["/", "/events", "/scene", f"/{RECORDED}", "/certificate.json"])
def test_nothing_can_be_changed(finished: Path, method: str, path: str) -> None:
    assert get(finished, path, method=method).status == 405


def test_an_address_has_an_end(finished: Path) -> None:
    assert get(finished, "/scene", query=f"problem={'a' * 1000}&test=0").status == 414
    assert get(finished, "/" + "a" * 1000).status == 414


@pytest.mark.parametrize(
    ("path", "headers"),
    [("/", HOST), ("/story.json", HOST), ("/nowhere", HOST), (f"/{RECORDED}", HOST), ("/", (("host", "evil"),))],
)
def test_every_response_has_the_security_headers(
    finished: Path, path: str, headers: tuple[tuple[str, str], ...]
) -> None:
    told = get(finished, path, headers=headers).headers
    assert "default-src 'none'" in told["content-security-policy"]
    assert "frame-ancestors 'none'" in told["content-security-policy"]
    assert "unsafe" not in told["content-security-policy"]
    assert told["x-content-type-options"] == "nosniff"
    assert told["referrer-policy"] == "no-referrer"
    assert told["cross-origin-resource-policy"] == "same-origin"
    assert told["cache-control"] == "no-store"
    assert not [name for name in told if name.startswith("access-control")]


# Routes


def test_the_page_has_the_story_and_asks_for_events(finished: Path) -> None:
    answer = get(finished, "/")
    assert answer.status == 200
    assert '<body data-live="events">' in answer.text
    assert '"name":"test-function"' in answer.text
    assert "connect-src 'self'" in answer.headers["content-security-policy"]
    assert "{{STORY}}" not in answer.text


def test_a_page_does_not_wait_for_a_campaign_that_takes_long_to_read(
    stub: Stub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a million rollouts that is seconds; the events bring the data."""
    monkeypatch.setattr(app, "FIRST_PICTURE", 0.0)

    async def test(client: Client, _: SnapshotCache) -> None:
        empty, other = await asyncio.gather(client.ask("/"), client.ask("/"))
        assert empty.status == other.status == 200
        assert '<body data-live="events">' in empty.text
        assert '<script type="application/json" id="story"></script>' in empty.text
        answer = Answer()
        stream = client.open(answer.take)
        await until(lambda: answer.stories)
        assert stub.refreshes >= 1
        await gone(stream)
        monkeypatch.setattr(app, "FIRST_PICTURE", PATIENCE)
        assert '"name":"test-function"' in (await client.ask("/")).text

    watching(stub, test)


def test_the_story(finished: Path) -> None:
    answer = get(finished, "/story.json")
    story = json.loads(answer.body)
    assert answer.headers["content-type"] == "application/json"
    assert (story["name"], story["state"], story["rollouts"]) == ("test-function", "finished", 6)
    assert story["updated"] is not None


def test_a_scene(finished: Path) -> None:
    answer = get(finished, "/scene", query="problem=maximum&test=2")
    assert (answer.status, json.loads(answer.body)["test"]) == (200, 2)


@pytest.mark.parametrize(
    ("query", "status", "text"),
    [
        ("problem=nothing&test=0", 404, "problem 'nothing'"),
        ("problem=maximum&test=3", 404, "test 3 choose 3"),
        ("problem=%00%0a&test=0", 404, "no problem"),
        ("problem=maximum&test=-1", 400, "use /scene?problem=NAME&test=NUMBER"),
        ("problem=maximum&test=٣", 400, "wrong query"),
        ("problem=maximum&test=9999999999999999999", 400, "wrong query"),
        ("problem=maximum", 400, "wrong query"),
        ("", 400, "wrong query"),
    ],
)
def test_a_scene_that_there_is_not(finished: Path, query: str, status: int, text: str) -> None:
    answer = get(finished, "/scene", query=query)
    assert answer.status == status
    assert says(answer.text, text)
    assert answer.text.count("\n") == 1
    assert answer.headers["content-type"].startswith("text/plain")


def test_a_recorded_file(finished: Path) -> None:
    answer = get(finished, f"/{RECORDED}")
    assert (answer.status, answer.body) == (200, (finished / RECORDED).read_bytes())
    assert answer.headers["content-disposition"] == "attachment"


@pytest.mark.parametrize(
    "path",
    [
        "/trajectories/../campaign.db",
        "/trajectories/../../run/campaign.db",
        "/trajectories/maximum/0/../../../campaign.db",
        "/trajectories//etc/passwd",
        "/trajectories/maximum/0/../0/maximum.0.true.0.mcap",
        "/trajectories/maximum/../maximum/0/maximum.0.true.0.mcap",
        "/trajectories/./maximum/0/maximum.0.true.0.mcap",
        "/trajectories/maximum/00/maximum.0.true.0.mcap",
        "/trajectories/maximum/1/maximum.0.true.0.mcap",
        "/trajectories/maximum/0/maximum.0.true.00.mcap",
        "/trajectories/maximum/0/maximum.0.true.0.mcap/",
        "/trajectories/maximum/0/maximum.0.true.0.mcap\0",
        "/trajectories/maximum/0/maximum.99999999999999999999.true.0.mcap",
        "/trajectories/maximum/0/maximum.0.true.9.mcap",
        "/trajectories/maximum/0/",
        "/trajectories/",
        "/campaign.db",
        "/manifest.sha256",
        "/../run/certificate.json",
        "//certificate.json",
    ],
)
def test_nothing_else_is_a_file(directory: Path, path: str) -> None:
    """Nor is an unrecorded one in the folder of the others."""
    shutil.copy(directory / RECORDED, directory / "trajectories/maximum/0/maximum.0.true.9.mcap")
    assert get(directory, path).status == 404


def test_a_link_is_not_followed(directory: Path, tmp_path: Path) -> None:
    """Not even to a file with the right bytes."""
    shutil.move(directory / RECORDED, tmp_path / "file")
    (directory / RECORDED).symlink_to(tmp_path / "file")
    assert get(directory, f"/{RECORDED}").status == 404
    shutil.move(directory / "trajectories/maximum", tmp_path / "folder")
    (directory / "trajectories/maximum").symlink_to(tmp_path / "folder")
    assert get(directory, "/trajectories/maximum/0/maximum.1.true.0.mcap").status == 404
    (tmp_path / "secret").write_text("{}")
    (directory / "certificate.json").unlink()
    (directory / "certificate.json").symlink_to(tmp_path / "secret")
    assert get(directory, "/certificate.json").status == 404


def test_a_file_that_was_changed_is_not_served(directory: Path) -> None:
    data = bytearray((directory / RECORDED).read_bytes())
    data[-20] ^= 1
    (directory / RECORDED).write_bytes(data)
    answer = get(directory, f"/{RECORDED}")
    assert answer.status == 404
    assert "sha256" in answer.text
    (directory / RECORDED).write_bytes(bytes(data) + b"more")
    assert get(directory, f"/{RECORDED}").status == 404
    (directory / RECORDED).unlink()
    assert get(directory, f"/{RECORDED}").status == 404
    os.mkfifo(directory / RECORDED)  # its reader would block
    assert get(directory, f"/{RECORDED}").status == 404


@pytest.mark.parametrize("path", ["../secret", "trajectories/../../secret", "/etc/passwd"])
def test_a_foreign_database_names_no_other_file(directory: Path, tmp_path: Path, path: str) -> None:
    (tmp_path / "secret").write_text("secret")
    with closing(sqlite3.connect(directory / DATABASE, isolation_level=None)) as connection:
        connection.execute("DROP TRIGGER rollouts_no_update")
        connection.execute("UPDATE rollouts SET path = ? WHERE test = 0", (path,))
    assert get(directory, f"/{path}").status == 404
    assert get(directory, f"/{RECORDED}").status == 404


def test_the_certificate(directory: Path) -> None:
    assert get(directory, "/certificate.json").body == (directory / "certificate.json").read_bytes()
    (directory / "certificate.json").unlink()
    assert get(directory, "/certificate.json").status == 404


def test_the_counterexamples(finished: Path) -> None:
    answer = get(finished, "/counterexamples.csv")
    assert answer.text.startswith("rollout,problem,test,")
    assert answer.headers["content-type"].startswith("text/csv")


def test_an_internal_error_is_reported_and_does_not_end_the_page(stub: Stub) -> None:
    said: list[str] = []

    async def test(client: Client, _: SnapshotCache) -> None:
        answer = Answer()
        with pytest.raises(ZeroDivisionError):  # for the server's log
            await client._application(scope("/scene", query="problem=a&test=0"), client._silent, answer.take)
        assert answer.status == 500
        assert (await client.ask("/story.json")).status == 200

    watching(stub, test, said)
    assert said == ["/scene: ZeroDivisionError('a fault of ours')"]


# Events


def test_an_event_when_something_changes_and_not_otherwise(stub: Stub) -> None:
    async def test(client: Client, _: SnapshotCache) -> None:
        answer = Answer()
        stream = client.open(answer.take)
        await until(lambda: stub.refreshes >= 10)  # each at another time
        assert answer.body.startswith(b"retry: 1000\n\n")
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert [story["rollouts"] for story in answer.stories] == [6]
        stub.story = replace(stub.story, rollouts=7)
        await until(lambda: len(answer.stories) == 2)
        snapshots = stub.refreshes
        await until(lambda: stub.refreshes >= snapshots + 10)
        assert [story["rollouts"] for story in answer.stories] == [6, 7]
        await gone(stream)

    watching(stub, test)


def test_a_quiet_stream_is_kept_alive(stub: Stub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "KEEP_ALIVE", 0.02)

    async def test(client: Client, _: SnapshotCache) -> None:
        answer = Answer()
        stream = client.open(answer.take)
        await until(lambda: answer.body.endswith(b": still here\n\n: still here\n\n"))
        await gone(stream)

    watching(stub, test)


def test_nothing_is_refreshed_without_clients(stub: Stub) -> None:
    async def test(client: Client, _: SnapshotCache) -> None:
        await asyncio.sleep(0.1)
        assert stub.refreshes == 0
        answers = Answer(), Answer(), Answer()
        streams = [client.open(answer.take) for answer in answers]
        await until(lambda: all(answer.stories for answer in answers))
        await gone(*streams)
        snapshots = stub.refreshes
        await asyncio.sleep(0.1)
        assert stub.refreshes == snapshots

    watching(stub, test)


def test_clients_share_one_refresh(stub: Stub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots_module, "SHORTEST_PAUSE", 60.0)
    monkeypatch.setattr(snapshots_module, "LONGEST_PAUSE", 60.0)

    async def test(client: Client, _: SnapshotCache) -> None:
        answers = [Answer() for _ in range(10)]
        streams = [client.open(answer.take) for answer in answers]
        await until(lambda: all(answer.stories for answer in answers))
        await client.ask("/story.json")
        assert stub.refreshes == 1
        await gone(*streams)

    watching(stub, test)


def test_the_number_of_streams_is_limited(stub: Stub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "MOST_STREAMS", 2)

    async def test(client: Client, _: SnapshotCache) -> None:
        first, second = Answer(), Answer()
        streams = [client.open(first.take), client.open(second.take)]
        await until(lambda: first.stories and second.stories)
        refused = await client.ask("/events")
        assert (refused.status, "2 pages are open" in refused.text) == (503, True)
        assert (await client.ask("/story.json")).status == 200
        await gone(streams[0])
        third = Answer()
        streams.append(client.open(third.take))
        await until(lambda: third.stories)
        await gone(*streams[1:])

    watching(stub, test)


def test_a_client_that_takes_nothing_holds_nobody_up(stub: Stub) -> None:
    async def never(_: Mapping[str, Any]) -> None:
        await asyncio.Event().wait()

    async def test(client: Client, _: SnapshotCache) -> None:
        stuck, answer = client.open(never), Answer()
        stream = client.open(answer.take)
        await until(lambda: answer.stories)
        stub.story = replace(stub.story, rollouts=7)
        await until(lambda: len(answer.stories) == 2)
        await gone(stuck, stream)

    watching(stub, test)


def test_a_failed_refresh_is_reported_once_and_the_page_keeps_its_data(stub: Stub) -> None:
    said: list[str] = []

    async def test(client: Client, _: SnapshotCache) -> None:
        stub.trouble = JournalError("the disk is gone")
        answer = Answer()
        stream = client.open(answer.take)
        await until(lambda: stub.refreshes >= 3)
        for path in ("/story.json", "/"):
            refused = await client.ask(path)
            assert (refused.status, refused.text) == (503, "the disk is gone\n")
        # A page that did not wait for the data gets the reason.
        assert answer.text.count("event: fault\ndata: the disk is gone\n\n") == 1
        stub.trouble = None
        await until(lambda: answer.stories)
        stub.trouble = ZeroDivisionError("a fault of ours")
        refreshes = stub.refreshes
        await until(lambda: stub.refreshes > refreshes)
        assert (await client.ask("/story.json")).status == 200
        stub.trouble, stub.story = None, replace(stub.story, rollouts=7)
        await until(lambda: len(answer.stories) == 2)
        await gone(stream)

    watching(stub, test, said)
    assert said == ["the disk is gone", "the page could not be refreshed: ZeroDivisionError('a fault of ours')"]


def test_every_stream_ends_with_the_last_snapshot(stub: Stub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots_module, "SHORTEST_PAUSE", 60.0)
    monkeypatch.setattr(snapshots_module, "LONGEST_PAUSE", 60.0)

    async def test(client: Client, snapshots: SnapshotCache) -> None:
        answers = Answer(), Answer()
        streams = [client.open(answer.take) for answer in answers]
        await until(lambda: all(answer.stories for answer in answers))
        stub.story = replace(stub.story, rollouts=9)
        snapshots.closing.set()
        await asyncio.gather(*streams)
        assert [[story["rollouts"] for story in answer.stories] for answer in answers] == [[6, 9], [6, 9]]

    watching(stub, test)


def test_the_state_of_the_workers_is_served(finished: Path) -> None:
    async def whole() -> dict[str, Any]:
        snapshots = SnapshotCache(Collector(finished), pytest.fail)
        snapshots.live = {"<b>new</b>": LiveState("busy", "maximum.0.true.0", 1.5e9)}
        answer = await Client(app.application(finished, snapshots, Address())).ask("/story.json")
        assert "<" not in answer.text
        return {worker["name"]: worker for worker in json.loads(answer.body)["workers"]}

    workers = asyncio.run(whole())
    new = workers.pop("<b>new</b>")
    assert (new["state"], new["rollout"], new["heartbeat"]) == ("busy", "maximum.0.true.0", 1.5e9)
    assert {worker["state"] for worker in workers.values()} == {"unknown"}


def test_the_link_to_the_router_is_served(finished: Path) -> None:
    async def served(link: RouterLink | None) -> Any:
        snapshots = SnapshotCache(Collector(finished), pytest.fail)
        snapshots.link = link
        return json.loads((await snapshots.available()).json)["link"]

    assert asyncio.run(served(RouterLink(12.0, 0))) == {"down_for": 12.0, "routers": 0}
    assert asyncio.run(served(RouterLink(None, 1))) == {"down_for": None, "routers": 1}
    assert asyncio.run(served(None)) is None


def test_the_process_of_a_page_takes_the_link_from_the_feed_and_drops_it_at_its_end(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[RouterLink | None] = []
    server = Server(finished, Address(), pytest.fail)
    monkeypatch.setattr(signal, "alarm", lambda _: taken.append(server.snapshots.link))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        figures = RunFigures(1.8e9, {}, {}, 0, 0, 0, CommitTimes(), False, RouterLink(12.0, 0))
        ours.send(json.dumps(asdict(figures)).encode())
        ours.shutdown(socket.SHUT_WR)
        process._follow(theirs, server)
    assert taken == [RouterLink(12.0, 0)]
    assert server.snapshots.link is None
