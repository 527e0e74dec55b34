"""Durable writing: whole files in their places, or no trace of them."""

import errno
import os
from pathlib import Path

import pytest

from perfbound.schemas import atomic


def names(directory: Path) -> list[str]:
    return sorted(str(path.relative_to(directory)) for path in directory.rglob("*") if path.is_file())


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    found: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        found.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return found


def test_files_and_their_folder_are_synced_before_the_caller_continues(tmp_path: Path, synced: list[str]) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    with atomic.replacing([one, two]) as files:
        for file in files:
            file.write(b"data")
        assert not one.exists()
    partials = [str(atomic.temporary(path, f".{os.getpid()}")) for path in (one, two)]
    assert synced == [*partials, str(tmp_path)]
    assert (names(tmp_path), one.read_bytes()) == (["one", "two"], b"data")


def test_an_error_in_the_block_leaves_what_was_there(tmp_path: Path) -> None:
    one = tmp_path / "one"
    one.write_bytes(b"before")

    def broken_off() -> None:
        with atomic.replacing([one, tmp_path / "two"]) as files:
            files[0].write(b"after")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        broken_off()
    assert (names(tmp_path), one.read_bytes()) == (["one"], b"before")


def test_new_files_are_synced_with_their_folder_and_have_their_mode(tmp_path: Path, synced: list[str]) -> None:
    atomic.write_new({tmp_path / "secret": (b"s", 0o600), tmp_path / "open": (b"o", 0o640)})
    assert len(synced) == 3
    assert synced[-1] == str(tmp_path)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in ("secret", "open")] == [0o600, 0o640]
    assert names(tmp_path) == ["open", "secret"]


def test_new_files_are_made_all_or_none(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"mine")
    with pytest.raises(FileExistsError) as caught:
        atomic.write_new({tmp_path / "a": (b"a", 0o600), tmp_path / "b": (b"b", 0o600)})
    assert caught.value.filename2 == str(tmp_path / "b")
    assert names(tmp_path) == ["b"]
    assert (tmp_path / "b").read_bytes() == b"mine"


def test_a_folder_that_cannot_be_synced_takes_new_files_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(_path: Path) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(atomic, "sync", failing)
    with pytest.raises(OSError, match="Input/output error"):
        atomic.write_new({tmp_path / "a": (b"a", 0o600)})
    assert names(tmp_path) == []
