"""Trajectory files: written whole or not at all, and read only if they are what was recorded."""

import errno
import hashlib
import itertools
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.store import files
from perfbound.schemas import atomic
from perfbound.schemas.errors import EvidenceError, TrajectoryError
from perfbound.schemas.ids import FileId, RolloutId
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap
from tests.facts import facts

DATA = b"evidence" * 1000
NAME = "trajectories/p/0/p.0.true.0.mcap"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def names(directory: Path) -> list[str]:
    return sorted(str(path.relative_to(directory)) for path in directory.rglob("*") if path.is_file())


def test_a_thousand_tests_a_folder() -> None:
    assert files.relative_path(FileId(RolloutId("p", 1999, "true", 2))) == "trajectories/p/1/p.1999.true.2.mcap"
    assert files.relative_path(FileId(RolloutId("p", 0, "true", 2), 64)) == "trajectories/p/0/p.0.true.2.64.mcap"


def test_what_is_written_is_read(tmp_path: Path) -> None:
    atomic.write_whole(tmp_path / NAME, b"before")
    atomic.write_whole(tmp_path / NAME, DATA)
    assert files.read_evidence(tmp_path, NAME, sha256(DATA)) == DATA
    assert names(tmp_path) == [NAME]


def test_every_new_folder_is_made_durable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    atomic.write_whole(tmp_path / NAME, DATA)
    folder = (tmp_path / NAME).parent
    assert synced == [
        str(tmp_path),
        str(folder.parents[1]),
        str(folder.parent),
        str(tmp_path / (NAME + atomic.TEMPORARY)),
        str(folder),
    ]


def disk_full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_batch_is_in_place_at_its_end_or_not_at_all(tmp_path: Path) -> None:
    batch, paths = files.Batch(), [tmp_path / f"{n}/file.mcap" for n in range(20)]

    def broken_off() -> None:
        with batch:
            batch.write(paths[0], DATA)
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        broken_off()
    assert names(tmp_path) == []
    with batch:
        for path in paths:
            batch.write(path, DATA)
        assert not any(path.exists() for path in paths)
    assert [path.read_bytes() for path in paths] == [DATA] * 20
    assert len(names(tmp_path)) == 20


@pytest.mark.parametrize("number", [1, 3])
@pytest.mark.parametrize("failing", range(1, 5))
def test_a_sync_that_fails_ends_the_batch_and_the_next_one_writes_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, failing: int
) -> None:
    """Whichever sync it is; one of the last file or of the folder comes after the renames."""
    calls, real = itertools.count(1), os.fsync

    def fsync(descriptor: int) -> None:
        if next(calls) == failing:
            disk_full()
        real(descriptor)

    batch, paths = files.Batch(), [tmp_path / f"{n}.mcap" for n in range(number)]

    def written() -> None:
        with batch:
            for path in paths:
                batch.write(path, DATA)

    monkeypatch.setattr(os, "fsync", fsync)
    if failing <= number + 1:
        with pytest.raises(OSError, match="No space left"):
            written()
    assert not [name for name in names(tmp_path) if name.endswith(atomic.TEMPORARY)]
    written()
    assert [path.read_bytes() for path in paths] == [DATA] * number
    assert len(names(tmp_path)) == number


@pytest.mark.parametrize(("owner", "name"), [(os, "fsync"), (Path, "replace")])
@pytest.mark.parametrize("before", [None, b"before"])
def test_a_full_disk_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, before: bytes | None
) -> None:
    path = tmp_path / "file.mcap"
    if before is not None:
        path.write_bytes(before)
    monkeypatch.setattr(owner, name, disk_full)
    with pytest.raises(OSError, match="No space left"):
        atomic.write_whole(path, DATA)
    assert names(tmp_path) == ([] if before is None else ["file.mcap"])
    assert before is None or path.read_bytes() == before


@pytest.mark.parametrize("change", [lambda data: data[:-1], lambda data: data + b"\0", lambda data: b"E" + data[1:]])
def test_changed_bytes_are_refused(tmp_path: Path, change: Any) -> None:
    atomic.write_whole(tmp_path / NAME, DATA)
    (tmp_path / NAME).write_bytes(change(DATA))
    with pytest.raises(EvidenceError, match=facts("recorded copy")):
        files.read_evidence(tmp_path, NAME, sha256(DATA))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(EvidenceError, match=r"p\.0\.true\.0\.mcap: No such file"):
        files.read_evidence(tmp_path, NAME, sha256(DATA))


def test_a_crash_is_swept_away(tmp_path: Path) -> None:
    atomic.write_whole(tmp_path / NAME, DATA)
    (tmp_path / (NAME + atomic.TEMPORARY)).write_bytes(b"half")
    atomic.write_whole(tmp_path / "trajectories/p/0/unknown.mcap", DATA)
    files.sweep(tmp_path, {NAME})
    assert names(tmp_path) == [NAME]


# Content of a file


def a_file(request: dict[str, Any]) -> bytes:
    trajectory = Trajectory(("t", "x"), np.array([[0.0, 1.0]]))
    return encode(trajectory, request=request, metadata={"seed": "7"}, units={"t": "s", "x": "m"})


def test_a_file_names_its_request() -> None:
    file = read_mcap(a_file({"seed": 7, "x": [0.1, -0.0]}))
    assert file.request == {"seed": 7, "x": [0.1, -0.0]}
    assert file.metadata == {"seed": "7", "columns": '["t", "x"]'}
    assert file.trajectory.samples.tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("text", [b"[]", b"{", b"\xff", b"", b"1"])
def test_a_request_that_is_no_object_is_refused(text: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    from perfbound.schemas.trajectory import trajectory as module

    class Text(str):
        def encode(self, *_: Any) -> bytes:
            return text

    monkeypatch.setattr(module, "canonical_json", lambda _: Text())
    with pytest.raises(TrajectoryError):
        read_mcap(a_file({}))
