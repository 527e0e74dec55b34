"""The history of a requirement: which campaigns it has, in which order, and with which intervals."""

import io
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from perfbound.orchestrator.release import history as module
from perfbound.orchestrator.release.history import History, history, print_history
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts
from tests.fakes.simulators import robustness, simulate

EXACT = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}
PARTS = [
    {"name": "low", "formula": "value >= 0"},
    {"name": "high", "formula": "value >= 0.45", "id": "R-2"},
]


def slope(request: RolloutRequest) -> float:
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


def shifted(by: float, request: RolloutRequest) -> float:
    return slope(request) + by


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Two versions of one question, one of another, one of two requirements, and one that has not finished."""
    found = tmp_path_factory.mktemp("history")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        small: dict[str, Any] = {"spot_check": 0, "recheck": 0, "max_tests": 20}
        for name, shift in (("v1", 0.0), ("v2", 0.2)):
            config = robustness(EXACT, name=name, **small)
            assert simulate(found / "versions" / name, config, partial(shifted, shift), noisy=False)
        other = robustness(EXACT, name="other", specification="value >= 0.01", **small)
        assert simulate(found / "versions" / "a-other", other, slope, noisy=False)
        assert simulate(found / "open", robustness(EXACT, **small), slope, noisy=False, stop=lambda _: True) is None
        several = robustness({"method": "sample"}, specification=None, specifications=PARTS, **small)
        assert simulate(found / "several", several, slope, noisy=True)
        yield found


@pytest.fixture(autouse=True)
def times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their names order them: v1, v2, and `a-other` before both."""
    monkeypatch.setattr(module, "last_outcome", lambda each: 1e9 + 86_400 * sum(map(ord, each.name[:2])))


def printed(found: History) -> str:
    console = Console(width=40, file=io.StringIO())
    print_history(found, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_versions_of_one_question_come_in_their_order(runs: Path) -> None:
    found = history(runs / "versions", None)
    assert [each.directory.name for each in found.versions] == ["v1", "v2"]
    assert (found.others, found.unreadable) == (1, ())
    (one, two) = ((each.lower, each.upper) for each in found.versions)
    assert None not in (*one, *two)
    assert one[0] <= 0.3 <= one[1] < two[0] + 0.1  # type: ignore[operator]
    assert two[0] <= 0.5 <= two[1]  # type: ignore[operator]
    text = printed(found)
    assert "worst robustness over all starts: value >= 0" in text
    assert text.index("v1") < text.index("v2")
    assert "1 finished campaign in this folder left out" in text
    assert max(map(len, text.splitlines())) > 80, "no line is cut"


@pytest.mark.parametrize("wanted", ["R-2", "high"])
def test_a_requirement_is_named_by_id_or_name(runs: Path, wanted: str) -> None:
    (found,) = history(runs, wanted).versions
    assert found.question[::2][:2] == ("failure_probability", "value >= 0.45")
    assert found.lower is None, "only the first claim has a bound from the other side"
    assert 0.3 < (found.upper or 0.0) < 1.0
    assert history(runs, wanted).others == 3
    (whole,) = history(runs / "several", None).versions
    assert whole.question[2] == "(value >= 0) and (value >= 0.45)"
    assert whole.lower is not None


def test_the_last_rollout_decides_the_order_and_no_name(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for order in (["v1", "v2"], ["v2", "v1"]):
        monkeypatch.setattr(module, "last_outcome", lambda each, of=order: 1e9 + of.index(each.name))
        monkeypatch.setattr(module, "run_directories", lambda folder: [folder / "v1", folder / "v2"])
        assert [each.directory.name for each in history(runs / "versions", None).versions] == order


def test_other_starts_are_another_question_and_comparisons_no_versions(runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "versions", tmp_path / "all")
    small: dict[str, Any] = {"spot_check": 0, "recheck": 0, "max_tests": 20}
    box = {"z1": {"low": 0.0, "high": 0.5, "unit": "1"}, "z2": {"low": 0.0, "high": 1.0, "unit": "1"}}
    assert simulate(tmp_path / "all" / "b-narrow", robustness(EXACT, space=box, **small), slope, noisy=False)
    pair = robustness({"method": "sample"}, draws="0" * 64, **small)
    assert simulate(tmp_path / "all" / "zz", pair, slope, noisy=True)
    found = history(tmp_path / "all", None)
    assert ([each.directory.name for each in found.versions], found.others) == (["v1", "v2"], 3)


def test_a_refuted_claim_has_no_probability(runs: Path) -> None:
    found = history(runs / "versions", None)
    assert "refuted" in printed(replace(found, versions=(replace(found.versions[0], refuted=True),)))


@pytest.mark.parametrize(
    ("folder", "requirement", "reason"),
    [("open", None, "open no finished campaign"), (".", "R-9", "requirement 'R-9'"), ("none", None, "no such folder")],
)
def test_what_has_no_history_is_one_line(runs: Path, folder: str, requirement: str | None, reason: str) -> None:
    with pytest.raises(PerfboundError, match=facts(reason)):
        history(runs / folder, requirement)


def test_a_damaged_campaign_is_named_and_left_out(runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "versions", tmp_path / "all")
    (tmp_path / "all" / "v1" / "certificate.json").write_text("{")
    found = history(tmp_path / "all", None)
    assert [each.directory.name for each in found.versions] == ["v2"]
    assert "v1: cannot be read, and is left out" in printed(found)
    shutil.rmtree(tmp_path / "all" / "v2")
    shutil.rmtree(tmp_path / "all" / "a-other")
    with pytest.raises(PerfboundError, match=facts("no finished campaign v1 cannot be read")):
        history(tmp_path / "all", None)
