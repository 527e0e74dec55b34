"""The secret of a user: one for all processes, refused where others could know or replace it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from perfbound.schemas.errors import SecretError
from perfbound.schemas.link.secret import VARIABLE, given_secret, secret_file, shared_secret, user_secret

TEXT = "0123456789abcdef0123"


def here(folder: Path) -> dict[str, str]:
    return {"XDG_STATE_HOME": str(folder)}


def written(folder: Path, mode: int = 0o600) -> Path:
    path = secret_file(here(folder))
    path.parent.mkdir(mode=0o700, parents=True)
    path.write_text(TEXT)
    path.chmod(mode)
    return path


def test_the_file_is_made_once_and_for_this_user_alone(tmp_path: Path) -> None:
    found = user_secret(here(tmp_path / "state"))
    path = secret_file(here(tmp_path / "state"))
    assert path == tmp_path / "state" / "perfbound" / "secret"
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.parent.stat().st_mode & 0o777 == 0o700
    assert len(found) == 64
    assert user_secret(here(tmp_path / "state")) == found
    assert [each.name for each in path.parent.iterdir()] == ["secret"]


@pytest.mark.integration
def test_processes_that_race_agree(tmp_path: Path) -> None:
    code = (
        "import sys; from perfbound.schemas.link.secret import user_secret;"
        "sys.stdin.read(); print(user_secret().decode())"
    )
    racers = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **here(tmp_path / "state")},
        )
        for _ in range(4)
    ]
    for racer in racers:
        assert racer.stdin is not None
        racer.stdin.close()
        racer.stdin = None
    assert len({racer.communicate()[0] for racer in racers}) == 1
    assert all(racer.returncode == 0 for racer in racers)


def test_the_environment_comes_first(tmp_path: Path) -> None:
    environment = {**here(tmp_path / "state"), VARIABLE: f" {TEXT}\n"}
    assert shared_secret(loopback=True, environment=environment) == TEXT.encode()
    assert shared_secret(loopback=False, environment=environment) == TEXT.encode()
    assert not (tmp_path / "state").exists()


def test_only_loopback_asks_for_the_secret_of_the_user(tmp_path: Path) -> None:
    assert shared_secret(loopback=False, environment=here(tmp_path / "state")) is None
    assert shared_secret(loopback=True, environment=here(tmp_path / "state"))


@pytest.mark.parametrize("text", ["", "short", "x" * 1001, "a\nb" * 9, "\x1b[2J" * 9])
def test_what_is_no_secret_is_refused(text: str) -> None:
    with pytest.raises(SecretError, match="16 to 1000 printable characters") as refused:
        given_secret({VARIABLE: text})
    assert text[:16] == "" or text[:16] not in str(refused.value)


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o606, 0o660])
def test_a_file_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    path = written(tmp_path / "state", mode)
    with pytest.raises(SecretError, match="others could know this secret; remove it") as refused:
        user_secret(here(tmp_path / "state"))
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert TEXT not in str(refused.value)


def test_a_file_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "state")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(SecretError, match="belongs to this user"):
        user_secret(here(tmp_path / "state"))


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o707])
def test_a_folder_that_others_can_write_is_refused(tmp_path: Path, mode: int) -> None:
    written(tmp_path / "state").parent.chmod(mode)
    with pytest.raises(SecretError, match="others could replace the secret in it"):
        user_secret(here(tmp_path / "state"))


def test_symbolic_links_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "elsewhere")
    place = secret_file(here(tmp_path / "file"))
    place.parent.mkdir(mode=0o700, parents=True)
    place.symlink_to(path)
    with pytest.raises(SecretError, match="a symbolic link"):
        user_secret(here(tmp_path / "file"))
    (tmp_path / "folder").mkdir()
    secret_file(here(tmp_path / "folder")).parent.symlink_to(path.parent)
    with pytest.raises(SecretError, match="no symbolic link"):
        user_secret(here(tmp_path / "folder"))


def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    path = secret_file(here(tmp_path / "state"))
    path.parent.mkdir(mode=0o700, parents=True)
    os.mkfifo(path, 0o600)
    with pytest.raises(SecretError, match="as a file of this user"):
        user_secret(here(tmp_path / "state"))


def test_no_place_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file")
    with pytest.raises(SecretError, match=f"cannot be kept there .*set {VARIABLE}") as refused:
        user_secret(here(tmp_path / "state"))
    assert "\n" not in str(refused.value)


def test_a_relative_folder_does_not_count(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for environment in ({}, {"XDG_STATE_HOME": ""}, {"XDG_STATE_HOME": "state"}):
        assert secret_file(environment) == tmp_path / ".local" / "state" / "perfbound" / "secret"
