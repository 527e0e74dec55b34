"""The revision of the folder of a system."""

import subprocess
from pathlib import Path

import pytest

from perfbound.orchestrator.run.directory import revision

pytestmark = pytest.mark.integration


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b")
    command = ["git", "-C", str(folder), *who, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_a_commit_and_whether_files_are_changed(tmp_path: Path) -> None:
    folder = tmp_path / "repository" / "cars"
    folder.mkdir(parents=True)
    (folder / "cars.py").write_text("one")
    git(folder.parent, "init", "--quiet")
    assert revision(folder) is None, "no commit yet"
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "-m", "one")
    commit = git(folder, "rev-parse", "HEAD")[:12]
    assert revision(folder) == f"commit {commit}"
    (folder.parent / "beside").write_text("not of this folder")
    (folder / "data.csv").write_text("not in the repository")
    assert revision(folder) == f"commit {commit}"
    (folder / "cars.py").write_text("two")
    assert revision(folder) == f"commit {commit}, with changes"


def test_without_git_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert revision(tmp_path / "nothing") is None
    monkeypatch.setenv("PATH", str(tmp_path))
    assert revision(Path(__file__).parent) is None
