"""The list of campaigns: states, verdicts, order, search, and a damaged one among them."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.report.listing import DEPTH, campaigns_below, listing, run_directories
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts
from tests.fakes.simulators import robustness, simulate, spec
from tests.tampering import editing

FIXTURES = Path(__file__).parents[2] / "fixtures" / "finished"
RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


def slope(request: RolloutRequest) -> float:
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good campaign, a bad one a folder below, one that was stopped, one that is damaged, and other files."""
    found = tmp_path_factory.mktemp("runs")
    config = robustness(RIGOROUS, spot_check=0, recheck=0)
    assert simulate(found / "good", config, slope, noisy=False)
    assert simulate(found / "deeper" / "bad", config, lambda request: slope(request) - 0.5, noisy=False)
    assert simulate(found / "stopped", config, slope, noisy=False, stop=lambda _: True) is None
    (found / "damaged").mkdir()
    (found / "damaged" / "campaign.db").write_bytes(b"no database" * 100)
    (found / "notes").mkdir()
    for age, name in enumerate(("good", "deeper/bad", "stopped", "damaged")):
        os.utime(found / name / "campaign.db", (1000 - age, 1000 - age))
    return found


def test_each_has_its_state_and_verdict_and_the_last_one_is_first(folder: Path) -> None:
    found = list(campaigns_below(folder))
    assert [(each.directory.name, each.state, each.verdict) for each in found] == [
        ("good", "finished", "SHOWN"),
        ("bad", "finished", "VIOLATED"),
        ("stopped", "stopped", None),
        ("damaged", "damaged", None),
    ]
    assert found[0].bound.startswith(">= 0.")
    assert found[0].violations == 0
    assert found[1].violations
    assert found[3].violations is None
    assert "campaign.db: not a campaign database" in found[3].fault


@pytest.mark.parametrize(
    "edit", ["UPDATE schema SET version = 2", "ALTER TABLE rollouts RENAME COLUMN violations TO failed"]
)
def test_one_of_another_version_is_not_called_damaged(tmp_path: Path, edit: str) -> None:
    shutil.copytree(FIXTURES / "scenario", tmp_path / "old")
    with editing(tmp_path / "old") as database:
        database.execute(edit)
    (found,) = campaigns_below(tmp_path)
    assert (found.state, found.verdict) == ("other version", None)
    assert found.fault.endswith("; use the perfbound that wrote it")


def test_rollouts_without_a_robustness_are_counted(tmp_path: Path) -> None:
    column = {**RIGOROUS, "name": "maximum", "column": "value"}
    config = robustness(column, spot_check=0, recheck=0, specification=None)
    true = spec(noisy=False).model_copy(update={"variants": ("true",)})
    assert simulate(tmp_path / "column", config, slope, noisy=False, system=true)
    (found,) = campaigns_below(tmp_path)
    assert found.rollouts > 1
    assert found.violations is None
    (row,) = list(listing([found], now=found.changed))[1:]
    assert row.plain.split()[-5:-3] == [str(found.rollouts), "-"]


def test_columns_are_aligned_and_ages_said(folder: Path) -> None:
    head, *rows = (line.plain for line in listing(list(campaigns_below(folder)), now=1060.0))
    place = head.index("verdict")
    assert [row[place:].split()[0] for row in rows[:2]] == ["SHOWN", "VIOLATED"]
    assert rows[0].endswith("1 min 0 s ago")
    assert all(row[place - 2 : place] == "  " for row in rows)


def test_a_refuted_bound_does_not_look_like_a_good_one(tmp_path: Path) -> None:
    shutil.copytree(FIXTURES / "paper", tmp_path / "refuted")
    shutil.copytree(FIXTURES / "scenario", tmp_path / "good")
    found = {each.directory.name: each for each in campaigns_below(tmp_path)}
    assert (found["refuted"].refuted, found["good"].refuted) == (True, False)
    _, *rows = (row.plain for row in listing([found["refuted"], found["good"]], now=0.0))
    assert f"  refuted ({found['refuted'].bound})  " in rows[0]
    assert "refuted (" not in rows[1]


@pytest.mark.parametrize(("text", "names"), [("viol", ["bad"]), ("DEEPER", ["bad"]), ("stopped", ["stopped"])])
def test_a_search_looks_at_everything_that_is_shown(folder: Path, text: str, names: list[str]) -> None:
    assert [each.directory.name for each in campaigns_below(folder) if each.has(text)] == names


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(PerfboundError, match=facts("nowhere: folder")):
        list(campaigns_below(tmp_path / "nowhere"))


# The walk


def campaign_at(folder: Path, *names: str) -> Path:
    """Make what the walk takes for a run directory, with the folder of its trajectories."""
    directory = folder.joinpath(*names)
    (directory / "trajectories" / "robustness" / "0").mkdir(parents=True)
    (directory / "campaign.db").touch()
    return directory


def test_the_walk_ends_at_its_depth(tmp_path: Path) -> None:
    names = [f"level-{number}" for number in range(1, DEPTH + 2)]
    reached = [campaign_at(tmp_path / f"to-{depth}", *names[: depth - 1]) for depth in range(1, DEPTH + 1)]
    campaign_at(tmp_path / "too-deep", *names[:DEPTH])
    assert sorted(run_directories(tmp_path)) == sorted(reached)


def test_the_walk_does_not_enter_a_run_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its trajectories are thousands of files, and a campaign inside of it is part of its evidence, or forged."""
    outer = campaign_at(tmp_path, "outer")
    campaign_at(tmp_path, "outer", "inner")
    entered: list[str] = []
    scandir = os.scandir

    def counted(path: str) -> "Iterator[os.DirEntry[str]]":
        entered.append(str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", counted)
    assert list(run_directories(tmp_path)) == [outer]
    assert entered == [str(tmp_path), str(outer)]


def test_the_walk_follows_no_link(tmp_path: Path) -> None:
    elsewhere = campaign_at(tmp_path, "elsewhere", "run").parent
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "link").symlink_to(elsewhere)
    assert list(run_directories(tmp_path / "runs")) == []
