"""Clean-up: old runs go, and never one that is running, signed, newer, verified if that is asked, or not ours alone."""

import os
import shutil
import time
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.orchestrator.release.clean import OWN, judge_runs, remove_runs
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.amounts import seconds_of

SAMPLE = Path(__file__).parents[2] / "fixtures" / "finished" / "sample"
DAY = 86_400.0


def copy(place: Path, days: float = 40.0) -> Path:
    """Return a copy of a finished run, so many days old."""
    shutil.copytree(SAMPLE, place)
    then = time.time() - days * DAY
    os.utime(place / DATABASE, (then, then))
    return place


def judged(folder: Path, *, keep_verified: bool = False) -> dict[str, str]:
    found = judge_runs(folder, older=30 * DAY, keep_verified=keep_verified, report=lambda *_: None)
    return {str(each.directory.relative_to(folder)): each.kept for each in found}


def removed(folder: Path, *, keep_verified: bool = False) -> tuple[int, dict[str, str]]:
    found = judge_runs(folder, older=30 * DAY, keep_verified=keep_verified, report=lambda *_: None)
    reasons = dict[str, str]()
    freed = remove_runs(found, lambda each, reason: reasons.update({each.directory.name: reason}))
    return freed, reasons


def test_an_old_run_goes_as_a_whole_and_a_newer_one_stays(tmp_path: Path) -> None:
    old, new = copy(tmp_path / "old"), copy(tmp_path / "new", 10.0)
    size = sum(path.stat().st_size for path in old.rglob("*") if path.is_file())
    assert judged(tmp_path) == {"new": "newer", "old": ""}
    assert removed(tmp_path) == (size, {"old": ""})
    assert not old.exists()
    assert new.exists()
    assert removed(tmp_path) == (0, {})


def test_a_signed_run_stays_and_one_that_was_signed_before_it_was_extended(tmp_path: Path) -> None:
    keys.new_pair(tmp_path, "alice")
    sign.sign_certificate(copy(tmp_path / "runs" / "signed"), keys.load_private(tmp_path / "alice.key"))
    (copy(tmp_path / "runs" / "extended") / "certificate-1.dsse.json").write_text("{}")
    assert judged(tmp_path / "runs") == {"signed": "signed", "extended": "signed"}
    assert removed(tmp_path / "runs") == (0, {})


def test_a_running_campaign_stays(tmp_path: Path) -> None:
    old = copy(tmp_path / "old")
    with campaign_lock(old):
        assert judged(tmp_path) == {"old": "running"}


def test_a_run_that_was_signed_since_stays(tmp_path: Path) -> None:
    old = copy(tmp_path / "old")
    found = judge_runs(tmp_path, older=30 * DAY, keep_verified=False, report=lambda *_: None)
    (old / files.ENVELOPE).write_text("{}")
    reasons = list[str]()
    assert remove_runs(found, lambda _, reason: reasons.append(reason)) == 0
    assert reasons == ["it has just been signed"]
    assert (old / DATABASE).exists()


def test_files_of_others_keep_a_run(tmp_path: Path) -> None:
    (copy(tmp_path / "old") / "notes.txt").write_text("the run of the accident")
    assert judged(tmp_path) == {"old": "with notes.txt, not written by perfbound"}


def test_verified_runs_stay_if_that_is_asked_and_unfinished_or_damaged_ones_go(tmp_path: Path) -> None:
    copy(tmp_path / "good")
    (copy(tmp_path / "unfinished") / files.CERTIFICATE).unlink()
    broken = copy(tmp_path / "broken")
    next((broken / "trajectories").rglob("*.mcap")).write_bytes(b"damaged")
    unreadable = copy(tmp_path / "unreadable")
    (unreadable / files.CERTIFICATE).write_bytes(b"\xff")
    assert judged(tmp_path, keep_verified=True) == {
        "good": "verified",
        "unfinished": "",
        "broken": "",
        "unreadable": "",
    }
    assert set(judged(tmp_path).values()) == {""}


def test_links_are_not_followed(tmp_path: Path) -> None:
    outside = copy(tmp_path / "outside")
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "link").symlink_to(outside)
    old = copy(folder / "old")
    shutil.rmtree(old / "trajectories")
    (old / "trajectories").symlink_to(outside / "trajectories")
    assert judged(folder) == {"old": ""}
    removed(folder)
    assert not old.exists()
    assert any((outside / "trajectories").rglob("*.mcap"))


def test_after_a_crash_in_between_the_next_clean_up_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = copy(tmp_path / "old")

    def crash(_: Path) -> None:
        raise OSError("the disk is gone")

    monkeypatch.setattr(shutil, "rmtree", crash)
    freed, reasons = removed(tmp_path)
    assert (freed, reasons) == (0, {"old": "the disk is gone"})
    assert (old / DATABASE).exists()
    assert not (old / files.CERTIFICATE).exists(), "else it would look whole"
    monkeypatch.undo()
    then = time.time() - 40 * DAY
    os.utime(old / DATABASE, (then, then))
    assert removed(tmp_path)[1] == {"old": ""}
    assert not old.exists()


def test_every_file_of_a_run_is_known(tmp_path: Path) -> None:
    import fnmatch

    names = ["certificate-2.json", "certificate-2.dsse.json", "manifest-1.sha256", "report-1.html", "attempts-1.json"]
    for name in (*names, *(path.name for path in SAMPLE.iterdir()), f"{DATABASE}-wal", "so-far.json"):
        assert any(fnmatch.fnmatch(name, own) for own in OWN), name
    assert not any(fnmatch.fnmatch("notes.txt", own) for own in OWN)


@pytest.mark.parametrize("text", ["30", "d", "30 days", "-3d", "1e3d", ""])
def test_an_age_has_a_number_and_a_unit(text: str) -> None:
    with pytest.raises(ValueError, match="a number with a unit"):
        seconds_of(text)
    assert seconds_of(" 2w ") == 14 * DAY
