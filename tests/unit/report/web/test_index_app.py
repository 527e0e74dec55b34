"""The index of campaigns as a web application, called directly: access, look-up of paths, changes, limits."""

import asyncio
import json
import re
import shutil
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.report.web import app, index_cache, open_campaigns
from perfbound.orchestrator.report.web import snapshots as snapshots_module
from perfbound.orchestrator.report.web.campaign_index import CampaignIndex
from perfbound.orchestrator.report.web.index_app import index_application
from perfbound.orchestrator.report.web.index_cache import IndexCache
from perfbound.orchestrator.report.web.open_campaigns import OpenCampaigns
from perfbound.orchestrator.run.page.address import Address
from perfbound.schemas.file.reader import parse_campaign
from tests.campaigns import FOLDER, UNCHECKED
from tests.fakes.inmemory import campaign
from tests.unit.report.web.test_app import Answer, scope, until

RECORDED = "trajectories/maximum/0/maximum.0.true.0.mcap"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run directory of a finished campaign."""
    directory = tmp_path_factory.mktemp("index") / "run"
    text = (FOLDER / "test-function.toml").read_bytes()
    campaign(directory, parse_campaign(text, "test", resolution=5, max_tests=3, replicates=2, **UNCHECKED))
    return directory


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """Two copies, one of them a folder below, and a secret beside the folder."""
    shutil.copytree(made, tmp_path / "runs" / "one")
    shutil.copytree(made, tmp_path / "runs" / "more" / "two %2e")
    (tmp_path / "secret").write_text("secret")
    return tmp_path / "runs"


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots_module, "SHORTEST_PAUSE", 0.01)
    monkeypatch.setattr(snapshots_module, "LONGEST_PAUSE", 0.02)
    monkeypatch.setattr(index_cache, "SHORTEST_PAUSE", 0.01)
    monkeypatch.setattr(index_cache, "PAUSES", 0.0)


class Client:
    """A client of the application, in the event loop of the test."""

    def __init__(self, folder: Path, said: list[str] | None = None) -> None:
        report = pytest.fail if said is None else said.append
        self.index = CampaignIndex(folder, report)
        self.cache = IndexCache(self.index, report)
        self.campaigns = OpenCampaigns(report)
        self.application = index_application(self.cache, self.campaigns, Address("127.0.0.1", 8000))

    async def ask(self, path: str, raw: bytes | None = None, **asked: Any) -> Answer:
        answer = Answer()
        found = scope(path, **asked) | ({} if raw is None else {"raw_path": raw})
        await self.application(found, self._silent, answer.take)
        return answer

    def open(self, path: str, answer: Answer) -> "asyncio.Task[None]":
        """Ask for events; cancelled when the client goes."""

        async def streamed() -> None:
            await self.application(scope(path), self._silent, answer.take)

        return asyncio.get_running_loop().create_task(streamed())

    async def whole(self) -> Any:
        """Return the index when every campaign has been read."""
        while True:
            found = json.loads((await self.ask("/campaigns.json")).body)
            if not found["unread"]:
                return found

    @staticmethod
    async def _silent() -> Any:
        await asyncio.Event().wait()


Test = Callable[[Client], Coroutine[Any, Any, None]]


def with_client(folder: Path, test: Test, said: list[str] | None = None) -> None:
    async def whole() -> None:
        await test(Client(folder, said))

    asyncio.run(whole())


def ask(folder: Path, path: str, **asked: Any) -> Answer:
    return asyncio.run(Client(folder).ask(path, **asked))


# Access

PATHS = ("/", "/campaigns.json", "/runs/one/", "/runs/one/story.json", "/runs/one/events", "/runs/one", "/nowhere")


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "192.168.1.7", "localhost@evil"])
@pytest.mark.parametrize("path", PATHS)
def test_another_host_is_refused(folder: Path, host: str, path: str) -> None:
    """A web site whose name is changed to resolve to this machine (DNS rebinding) reads nothing."""
    answer = ask(folder, path, headers=(("host", host),))
    assert answer.status == 400
    assert b"test-function" not in answer.body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
@pytest.mark.parametrize("path", [*PATHS[:-2], "/runs/one/scene", f"/runs/one/{RECORDED}"])
def test_nothing_can_be_changed(folder: Path, method: str, path: str) -> None:
    assert ask(folder, path, method=method).status == 405


@pytest.mark.parametrize("path", [path for path in PATHS if not path.endswith("events")])
def test_every_response_has_the_security_headers(folder: Path, path: str) -> None:
    told = ask(folder, path).headers
    assert "default-src 'none'" in told["content-security-policy"]
    assert "frame-ancestors 'none'" in told["content-security-policy"]
    assert "unsafe" not in told["content-security-policy"]
    assert told["x-content-type-options"] == "nosniff"
    assert told["cross-origin-resource-policy"] == "same-origin"
    assert told["cache-control"] == "no-store"
    assert not [name for name in told if name.startswith("access-control")]


def test_an_address_has_an_end(folder: Path) -> None:
    assert ask(folder, "/runs/" + "a" * 1000).status == 414


# Paths


@pytest.mark.parametrize(
    "path",
    [
        *("/runs/", "/runs/..", "/runs/../", "/runs/./one/", "/runs//one/", "/runs/more/", "/runs/more/two/"),
        *("/runs/one/../../../secret", "/runs/..%2f..%2fsecret", "/runs/%2e%2e/%2e%2e/secret"),
        *("/runs/two", "/runs/%2e%2e%2fsecret/"),
        *("/runs/one%00/", "/runs/%ff/", "/runs/one/../one/", "/runs/linked/", "/runs/linked/certificate.json"),
        *("/runs/one/campaign.db", "/runs/one/..%2fcampaign.db", "/runs/one/trajectories/../campaign.db"),
        *("/runs/more/two %2e/", "/secret", "/campaign.db", "/one/", f"/{RECORDED}"),
    ],
)
def test_a_path_leads_to_no_other_file(folder: Path, path: str) -> None:
    (folder / "linked").symlink_to(folder.parent)
    shutil.copytree(folder / "one", folder.parent / "outside")
    answer = ask(folder, path)
    assert (answer.status, b"secret" in answer.body) == (404, False)


def test_a_link_is_not_served_wherever_it_is(folder: Path) -> None:
    (folder / "one" / "certificate.json").unlink()
    (folder / "one" / "certificate.json").symlink_to(folder.parent / "secret")
    assert ask(folder, "/runs/one/certificate.json").status == 404
    shutil.copytree(folder / "one", folder / "three")
    (folder / "three" / "campaign.db").unlink()
    (folder / "three" / "campaign.db").symlink_to(folder / "one" / "campaign.db")
    assert ask(folder, "/runs/three/").status == 404

    async def test(client: Client) -> None:
        assert (await client.ask("/runs/more/two%20%252e/story.json")).status == 200
        shutil.move(folder / "more", folder.parent / "moved")
        (folder / "more").symlink_to(folder.parent / "moved")
        assert (await client.ask("/runs/more/two%20%252e/story.json")).status == 404, "also where it was open"

    with_client(folder, test)


def test_each_campaign_is_a_click_away_and_the_index_one_back(folder: Path) -> None:
    async def test(client: Client) -> None:
        hrefs = {row["path"]: row["href"] for row in (await client.whole())["rows"]}
        assert hrefs == {"one": "runs/one/", "more/two %2e": "runs/more/two%20%252e/"}
        for href, back in (("runs/one/", "../../"), ("runs/more/two%20%252e/", "../../../")):
            page = await client.ask(f"/{href}")
            assert page.status == 200
            assert f'<nav class="up"><a href="{back}">' in page.text
            assert '<body data-live="events">' in page.text
            story = await client.ask(f"/{href}story.json")
            assert json.loads(story.body)["name"] == "test-function"
            recorded = await client.ask(f"/{href}{RECORDED}")
            assert recorded.body == (folder / "one" / RECORDED).read_bytes()
            assert (await client.ask(f"/{href}scene", query="problem=maximum&test=2")).status == 200

    with_client(folder, test)


def test_an_address_without_its_slash_is_moved_within_the_server(folder: Path) -> None:
    answer = ask(folder, "/runs/more/two %2e", raw=b"/runs/more/two%20%252e")
    assert (answer.status, answer.headers["location"]) == (307, "/runs/more/two%20%252e/")
    assert ask(folder, "//evil.example/runs/one").status == 404


# The index


def test_the_page_has_its_data_and_a_policy(folder: Path) -> None:
    hostile = "</script><script>alert(1)<!--"
    shutil.copytree(folder / "one", folder / hostile.replace("/", "\u2044"))

    async def test(client: Client) -> None:
        await client.whole()
        answer = await client.ask("/")
        story = re.search(r'<script type="application/json" id="story">(.*?)</script>', answer.text)
        assert story is not None
        data = json.loads(story[1])
        assert sorted(row["path"] for row in data["rows"])[1:] == ["more/two %2e", "one"]
        assert data["start"].startswith("perfbound run CAMPAIGN.toml --out ")
        assert answer.text.count("<script") == 2
        assert "<!--" not in answer.text
        assert "connect-src 'self'" in answer.headers["content-security-policy"]

    with_client(folder, test)


def test_an_answer_has_what_changed_since_the_last_one(folder: Path, made: Path) -> None:
    async def test(client: Client) -> None:
        first = await client.whole()
        assert (first["whole"], len(first["rows"])) == (True, 2)
        again = await client.ask("/campaigns.json", query=f"seen={first['stamp']}")
        assert (again.status, again.body) == (204, b"")
        shutil.copytree(made, folder / "new")
        while (answer := await client.ask("/campaigns.json", query=f"seen={first['stamp']}")).status == 204:
            await asyncio.sleep(0.005)
        changes = json.loads(answer.body)
        assert (changes["whole"], [row["path"] for row in changes["rows"]]) == (False, ["new"])
        for stamp in ("0" * 16 + "-3", "x", "", first["stamp"] + "9" * 20, "\u0663"):
            other = json.loads((await client.ask("/campaigns.json", query=f"seen={stamp}")).body)
            assert (other["whole"], len(other["rows"])) == (True, 3), "the number of another server means nothing here"

    with_client(folder, test)


def test_a_slow_campaign_keeps_nobody_waiting(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index_cache, "PATIENCE", 0.05)
    going, refreshes, refresh = threading.Event(), list[float](), CampaignIndex.refresh

    def slow(index: CampaignIndex, seconds: float) -> None:
        refreshes.append(seconds)
        refresh(index, seconds)
        going.wait()

    monkeypatch.setattr(CampaignIndex, "refresh", slow)

    async def test(client: Client) -> None:
        try:
            for _ in range(3):
                assert (await client.ask("/")).status == 200
                assert (await client.ask("/campaigns.json")).status == 200
            assert len(refreshes) == 1, "one refresh at a time"
        finally:
            going.set()
        await until(lambda: len(json.loads(client.index.since(-1).to_json())["rows"]) == 2)

    with_client(folder, test)


def test_a_failed_refresh_is_reported_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    def broken(*_: object) -> None:
        raise OSError("the disk is gone")

    async def test(client: Client) -> None:
        await client.whole()
        monkeypatch.setattr(CampaignIndex, "refresh", broken)
        for _ in range(5):
            assert len(json.loads((await client.ask("/campaigns.json")).body)["rows"]) == 2
            await asyncio.sleep(0.02)

    with_client(folder, test, said)
    assert said == ["the index could not be refreshed: OSError('the disk is gone')"]


def test_a_campaign_that_cannot_be_read_does_not_disturb_the_others(folder: Path) -> None:
    (folder / "one" / "campaign.db").write_bytes(b"no database" * 100)

    async def test(client: Client) -> None:
        found = {row["path"]: row["state"] for row in (await client.whole())["rows"]}
        assert found == {"one": "damaged", "more/two %2e": "finished"}
        assert (await client.ask("/runs/one/")).status == 503
        assert (await client.ask("/runs/more/two%20%252e/")).status == 200

    with_client(folder, test, [])


# Limits


@pytest.mark.rest
def test_few_campaigns_stay_in_memory(folder: Path, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_campaigns, "MOST_OPEN", 2)
    for name in "abc":
        shutil.copytree(made, folder / name)

    async def test(client: Client) -> None:
        for name in ("a", "b", "a", "c"):
            assert (await client.ask(f"/runs/{name}/story.json")).status == 200
        assert [each.name for each in client.campaigns._open] == ["a", "c"]
        answers = Answer(), Answer()
        streams = [client.open(f"/runs/{name}/events", answer) for name, answer in zip("ac", answers, strict=True)]
        await until(lambda: all(answer.stories for answer in answers))
        refused = await client.ask("/runs/b/")
        assert (refused.status, "too many campaigns are open" in refused.text) == (503, True)
        await gone(streams[0])
        assert (await client.ask("/runs/b/")).status == 200
        assert [each.name for each in client.campaigns._open] == ["c", "b"]
        await gone(streams[1])

    with_client(folder, test)


def test_all_campaigns_share_the_number_of_streams(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "MOST_STREAMS", 2)

    async def test(client: Client) -> None:
        answers = Answer(), Answer()
        paths = ("/runs/one/events", "/runs/more/two%20%252e/events")
        streams = [client.open(path, answer) for path, answer in zip(paths, answers, strict=True)]
        await until(lambda: all(answer.stories for answer in answers))
        assert (await client.ask("/runs/one/events")).status == 503
        client.campaigns.close()
        await asyncio.gather(*streams)

    with_client(folder, test)


async def gone(stream: "asyncio.Task[None]") -> None:
    stream.cancel()
    with suppress(asyncio.CancelledError):
        await stream
