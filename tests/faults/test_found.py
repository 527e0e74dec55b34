"""Faults that fault runs found, each as the smallest test that shows it."""

import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing, suppress
from pathlib import Path

import pytest

from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId
from perfbound.schemas.result.facts import Header
from perfbound.workers.systems import load_system
from tests.campaigns import config
from tests.end_to_end.processes import processes

ROLLOUT = RolloutId("maximum", 1, "true", 0)


def test_a_result_that_comes_after_its_attempt_was_given_up_shows_as_recorded(tmp_path: Path) -> None:
    """The database recorded `worker lost` for the attempt whose result was kept, and no worker that simulated it."""
    campaign = config("test-function")
    with closing(Journal.create(tmp_path, Header.new(campaign, load_system("test-function").spec, {}))) as journal:
        with journal.transaction():
            journal.attempts.ended(Attempt(ROLLOUT, 1), "w", Failure("infrastructure", "worker lost for 3 s"))
            journal.attempts.ended(Attempt(ROLLOUT, 1), "w", Failure("infrastructure", "no progress for 2 s"))
            journal.attempts.ended(Attempt(ROLLOUT, 1), "w", "recorded")
            journal.attempts.ended(Attempt(ROLLOUT, 1), "w", Failure("infrastructure", "the worker failed at last"))
        with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
            told = connection.execute("SELECT outcome FROM outcomes ORDER BY rowid").fetchall()
    assert told == [("worker lost for 3 s",), ("recorded",)]


HANGS = {
    "holds the lock of Python": "import ctypes; ctypes.PyDLL(None).sleep(600)",
    "stopped": "import os; os.kill(os.getpid(), 19)",
}


@pytest.mark.parametrize("how", HANGS)
def test_a_worker_that_cannot_run_ends_with_its_parent(how: str) -> None:
    """It had to read the end of a pipe, which it never did: it never ended."""
    bound = "from perfbound.workers.lifeline import die_with_parent; die_with_parent()"
    child = f"{bound}; print('hangs', flush=True); {HANGS[how]}"
    line = [sys.executable, "-c", child]
    parent = f"import subprocess as s; c = s.Popen({line!r}); print(c.pid, flush=True); c.wait()"
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        assert process.stdout.readline() == "hangs\n"
        process.kill()
        process.wait()
        try:
            assert process.stdout.read() == "", "the pipe closes with its last holder: the child is gone"
        finally:
            _kill(pid)


def _kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def test_a_database_that_was_never_finished_is_nobody_s_campaign(tmp_path: Path) -> None:
    """After kill -9 in the first moments, `run` refused the directory and `resume` found no campaign in it."""
    directory = tmp_path / "run"
    directory.mkdir()
    for name in ("campaign.db.partial", "campaign.db.partial-wal", "campaign.db.partial-shm"):
        (directory / name).write_bytes(b"unfinished")
    with processes(tmp_path / "p") as started:
        file = Path(__file__).parents[2] / "deploy" / "campaigns" / "test-function.toml"
        ended = started.run("perfbound", "run", file, "--out", directory)
    assert ended.code == 0, ended.err
    assert not list(directory.glob("*.partial*"))


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root for a small disk")
def test_a_full_disk_is_not_taken_for_a_damaged_database(tmp_path: Path) -> None:
    """`resume` on a full disk reported that campaign.db was no campaign database."""
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", disk], check=True)
    try:
        header = Header.new(config("test-function"), load_system("test-function").spec, {})
        Journal.create(disk, header).close()
        with (disk / "ballast").open("wb") as file, suppress(OSError):
            file.write(bytes(2**21))
        with pytest.raises(OSError, match=r"full|disk I/O error"):
            Journal.open(disk)
    finally:
        subprocess.run(["umount", "--lazy", disk], check=True)
