"""The index of campaigns in memory: what it reads again, what it lets through, and what does not disturb it."""

import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from perfbound.orchestrator.report.listing import campaigns_below, read_campaign
from perfbound.orchestrator.report.web import campaign_index
from perfbound.orchestrator.report.web.campaign_index import CampaignIndex, IndexChanges, IndexRow
from perfbound.orchestrator.store import lock
from perfbound.schemas.rollout import RolloutRequest
from tests.fakes.simulators import robustness, simulate

RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


def slope(request: RolloutRequest) -> float:
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that shows its requirement, one that violates it, and one that was stopped."""
    found = tmp_path_factory.mktemp("made")
    config = robustness(RIGOROUS, spot_check=0, recheck=0)
    assert simulate(found / "good", config, slope, noisy=False)
    assert simulate(found / "bad", config, lambda request: slope(request) - 0.5, noisy=False)
    assert simulate(found / "stopped", config, slope, noisy=False, stop=lambda each: each.test > 0) is None
    return found


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil, one campaign of it a folder below."""
    shutil.copytree(made / "good", tmp_path / "runs" / "good")
    shutil.copytree(made / "bad", tmp_path / "runs" / "deeper" / "bad")
    return tmp_path / "runs"


def rows(changes: IndexChanges) -> dict[str, IndexRow]:
    return {row.path: row for row in changes.rows}


class Reads:
    """Counts how often each campaign is read."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.names: list[str] = []
        self._read = read_campaign
        monkeypatch.setattr(campaign_index, "read_campaign", self._counted)

    def _counted(self, directory: Path, changed: float) -> object:
        self.names.append(directory.name)
        return self._read(directory, changed)


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> Reads:
    return Reads(monkeypatch)


def test_it_has_what_the_list_has_and_what_is_required(folder: Path, made: Path) -> None:
    shutil.copytree(made / "stopped", folder / "stopped")
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    found = rows(index.since(-1))
    assert found.keys() == {"good", "deeper/bad", "stopped"}
    listed = {str(each.directory.relative_to(folder)): each for each in campaigns_below(folder)}
    for path, row in found.items():
        same = listed[path]
        assert (row.name, row.state, row.verdict) == (same.name, same.state, same.verdict)
        assert (row.bound, row.rollouts, row.violations) == (same.bound, same.rollouts, same.violations or 0)
    good, bad = found["good"], found["deeper/bad"]
    assert (good.required, good.href, good.tests, good.reason) == (">= 0", "runs/good/", None, "")
    assert good.claim.startswith("Margin at least 0.")
    assert good.value is not None
    assert 0.0 <= good.value - float(good.bound.removeprefix(">= ")) < 1e-4
    assert bad.href == "runs/deeper/bad/"
    assert "the robustness is" in bad.reason
    stopped = found["stopped"]
    assert (stopped.tests in (1, 2, 3), stopped.most_tests) == (True, 40)
    assert (stopped.so_far.split()[0], good.so_far) == (">=", "")


@pytest.mark.integration
def test_only_what_changed_is_read_again(folder: Path, reads: Reads) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    assert sorted(reads.names) == ["bad", "good"]
    number = index.number
    index.refresh(60.0)
    assert (len(reads.names), index.number, index.since(number).rows) == (2, number, ())
    time.sleep(0.01)
    (folder / "good" / "certificate.json").unlink()
    for entry in index._entries.values():
        entry.due = 0.0
    index.refresh(60.0)
    assert reads.names[2:] == ["good"]
    changes = index.since(number)
    assert (changes.whole, [(row.path, row.state) for row in changes.rows]) == (False, [("good", "stopped")])


def test_a_campaign_that_is_taken_up_is_running(folder: Path) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    for entry in index._entries.values():
        entry.due = 0.0
    with lock.campaign_lock(folder / "good"):
        index.refresh(60.0)
        assert rows(index.since(-1))["good"].state == "running"
        for entry in index._entries.values():
            entry.due = 0.0
    index.refresh(60.0)
    assert rows(index.since(-1))["good"].state == "finished"


def test_a_campaign_that_takes_long_to_read_is_read_seldom(
    folder: Path, reads: Reads, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign_index, "MOST_OF_A_READ", 1e-6)
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    os.utime(folder / "good" / "campaign.db")
    index.refresh(60.0)
    assert sorted(reads.names) == ["bad", "good"]


def test_campaigns_come_and_go(folder: Path, made: Path) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    number = index.number
    shutil.copytree(made / "bad", folder / "new")
    index.refresh(60.0)
    changes = index.since(number)
    assert (changes.whole, [row.path for row in changes.rows]) == (False, ["new"])
    shutil.rmtree(folder / "good")
    index.refresh(60.0)
    after = index.since(changes.number)
    assert after.whole, "a row cannot be said to be gone alone"
    assert rows(after).keys() == {"new", "deeper/bad"}
    assert index.directory(b"good") is None
    assert index.since(after.number).rows == ()
    assert index.since(after.number + 1000).whole, "a number that this index never gave"


def test_a_refresh_ends_in_time_and_the_next_one_goes_on(folder: Path) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(0.0)
    assert (index.unread, len(index.since(-1).rows)) == (1, 2)
    index.refresh(0.0)
    assert index.unread == 0


def test_one_that_is_damaged_does_not_disturb_the_others(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, spoil in _WAYS.items():
        shutil.copytree(folder / "good", folder / name)
        spoil(folder / name)
    said: list[str] = []
    index = CampaignIndex(folder, said.append)
    index.refresh(60.0)
    found = rows(index.since(-1))
    assert {path: row.state for path, row in found.items() if row.state != "finished"} == dict.fromkeys(
        _WAYS, "damaged"
    )
    assert all(found[name].fault for name in _WAYS)
    assert not any(str(folder) in row.fault for row in found.values()), "no path of this machine"
    assert found["link"].fault == found["pipe"].fault == "campaign.db is a link or no file"
    assert said == []

    def faulty(*_: object) -> None:
        raise ZeroDivisionError("a fault of ours")

    monkeypatch.setattr(campaign_index, "_finished_row", faulty)
    index = CampaignIndex(folder, said.append)
    index.refresh(60.0)
    assert rows(index.since(-1))["good"].state == "damaged"
    assert len(said) == 2
    assert "a fault of ours" in said[0]


def _link(directory: Path) -> None:
    shutil.move(directory / "campaign.db", directory / "other")
    (directory / "campaign.db").symlink_to("other")


def _pipe(directory: Path) -> None:
    (directory / "campaign.db").unlink()
    os.mkfifo(directory / "campaign.db")


def _waiting_certificate(directory: Path) -> None:
    (directory / "certificate.json").unlink()
    os.mkfifo(directory / "certificate.json")


_WAYS: dict[str, Callable[[Path], object]] = {
    "random": lambda directory: (directory / "campaign.db").write_bytes(b"\0no database" * 99),
    "empty": lambda directory: (directory / "campaign.db").write_bytes(b""),
    "certificate": lambda directory: (directory / "certificate.json").write_text("{}"),
    "pipe-certificate": _waiting_certificate,
    "link": _link,
    "pipe": _pipe,
}


@pytest.mark.parametrize("path", [b"..", b"", b".", b"nowhere", b"good/..", b"deeper", b"good\0", b"/etc", b"\xff"])
def test_a_path_is_looked_up_and_never_opened(folder: Path, path: bytes) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    assert index.directory(b"deeper/bad") == folder / "deeper" / "bad"
    assert index.directory(path) is None


def test_a_link_that_comes_later_is_not_followed(folder: Path, made: Path) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    shutil.rmtree(folder / "deeper")
    (folder / "deeper").symlink_to(made)
    assert (folder / "deeper" / "bad" / "campaign.db").exists()
    assert index.directory(b"deeper/bad") is None
    index.refresh(60.0)
    assert rows(index.since(-1)).keys() == {"good"}, "nor below a folder"


def test_names_that_need_an_escape(folder: Path) -> None:
    names = ["a b", "ä", "%2e%2e", "<script>", "a'b\"c&", "new\nline"]
    for name in names:
        shutil.copytree(folder / "good", folder / name)
    shutil.copytree(folder / "good", folder / os.fsdecode(b"\xff"))
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    text = index.since(-1).to_json(folder=str(folder))
    assert not {"<", ">", "&"} & set(text)
    hrefs = {row["path"]: row["href"] for row in json.loads(text)["rows"]}
    assert hrefs["%2e%2e"] == "runs/%252e%252e/"
    assert hrefs["new\\nline"] == "runs/new%0Aline/"
    assert hrefs["\\udcff"] == "runs/%FF/"
    assert index.directory(b"\xff") is not None
    assert all(index.directory(name.encode()) == folder / name for name in names)


def test_an_index_has_an_end(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign_index, "MOST_CAMPAIGNS", 1)
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    changes = index.since(-1)
    assert (len(changes.rows), changes.more) == (1, True)


def test_a_folder_that_is_removed_is_empty(folder: Path) -> None:
    index = CampaignIndex(folder, pytest.fail)
    index.refresh(60.0)
    shutil.rmtree(folder)
    index.refresh(60.0)
    assert index.since(-1).rows == ()
