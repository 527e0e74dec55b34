"""Resume from every state of the run directory that a crash or a move leaves."""

import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from perfbound.orchestrator.store.rows import SCHEMA_VERSION
from tests.end_to_end import processes
from tests.end_to_end.processes import (
    ROLLOUTS,
    Processes,
    contents,
    of_run,
    query,
    recorded,
    wait_for,
    write_campaign,
)
from tests.tampering import editing


@pytest.fixture(scope="module")
def killed_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory as the kill of its orchestrator in mid-run left it."""
    folder = tmp_path_factory.mktemp("killed")
    directory = folder / "run"
    with processes.processes(folder) as started:
        process = started.start("perfbound", "run", write_campaign(folder / "c.toml"), "--out", directory)
        wait_for(lambda: len(list(directory.rglob("*.mcap"))) >= 10)
        process.popen.kill()
        assert process.wait().code == -signal.SIGKILL
        wait_for(lambda: not of_run(directory))
    return directory


@pytest.fixture
def killed(killed_once: Path, tmp_path: Path) -> Path:
    """A copy of it, with its times."""
    directory = Path(shutil.copytree(killed_once, tmp_path / "run"))
    assert 0 < recorded(directory) < ROLLOUTS
    return directory


def check(started: Processes, directory: Path, calm: Path, *, workers: int = 2) -> str:
    """Resume the campaign and compare it with the calm one; return the output."""
    ended = started.run("perfbound", "resume", directory, "--workers", str(workers))
    assert ended.code == 0, ended.err
    assert (directory / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()
    assert (directory / "manifest.sha256").read_bytes() == (calm / "manifest.sha256").read_bytes()
    assert recorded(directory) == ROLLOUTS
    assert len(list(directory.rglob("*.mcap"))) == ROLLOUTS
    return ended.err


@pytest.mark.parametrize("workers", [1, 3])
def test_a_copy_elsewhere_with_another_number_of_workers(
    started: Processes, killed: Path, calm: Path, workers: int
) -> None:
    copy = started.folder / "another machine" / "the run"
    shutil.copytree(killed, copy)
    shutil.rmtree(killed)
    check(started, copy, calm, workers=workers)


def last_transaction(directory: Path) -> None:
    """Cut the write-ahead log in the middle of what was written last."""
    log = directory / "campaign.db-wal"
    assert log.stat().st_size > 8192
    with log.open("r+b") as file:
        file.truncate(log.stat().st_size - 5000)


def no_shared_memory(directory: Path) -> None:
    """Forget what only lives as long as the machine is up."""
    (directory / "campaign.db-shm").unlink()


def newest_files(directory: Path) -> None:
    """Spoil the newest recorded trajectories as a disk does that lied about fsync: gone, cut, and all zeros.

    The newest file of all may have no fact: the kill came between the file and its commit.
    """
    newest = [
        directory / str(path) for (path,) in query(directory, "SELECT path FROM rollouts ORDER BY seq DESC LIMIT 3")
    ]
    newest[0].unlink()
    newest[1].write_bytes(newest[1].read_bytes()[:-1])
    newest[2].write_bytes(bytes(newest[2].stat().st_size))


def files_without_facts(directory: Path) -> None:
    """Leave a half-written file, and a whole one that no commit knows."""
    folder = next(directory.rglob("*.mcap")).parent
    (folder / "x.mcap.partial").write_bytes(b"half")
    shutil.copy(next(directory.rglob("*.mcap")), folder / "nominal_robustness.7.nominal.9.mcap")


@pytest.mark.journey
@pytest.mark.parametrize("damage", [last_transaction, no_shared_memory, newest_files, files_without_facts])
def test_what_a_power_cut_leaves(started: Processes, killed: Path, calm: Path, damage: Callable[[Path], None]) -> None:
    damage(killed)
    said = check(started, killed, calm)
    spoiled = damage is newest_files
    assert ("3 trajectory files are missing or damaged" in said) == spoiled
    assert query(killed, "SELECT count(*) FROM outcomes WHERE outcome = 'restored'") == [(3 if spoiled else 0,)]


def test_a_finished_campaign_prints_its_certificate_and_changes_nothing(started: Processes, calm: Path) -> None:
    directory = started.folder / "run"
    # Without what the queries of other tests leave beside the database: they open it as one that may be written.
    shutil.copytree(calm, directory, ignore=shutil.ignore_patterns("*-wal", "*-shm"))
    before = contents(directory)
    for command in ("resume", "status"):
        ended = started.run("perfbound", command, directory)
        assert ended.code == 0
        assert "CLAIM  rho* " in ended.out
    assert contents(directory) == before


def test_a_database_of_another_schema_version_is_refused(started: Processes, killed: Path) -> None:
    with editing(killed) as connection:
        connection.execute("UPDATE schema SET version = ?", (SCHEMA_VERSION + 1,))
    for command in ("status", "resume"):
        ended = started.run("perfbound", command, killed)
        assert ended.code == 1
        numbers = f"schema version {SCHEMA_VERSION + 1}, this perfbound reads {SCHEMA_VERSION}"
        assert f"{numbers}; use the perfbound that wrote it" in ended.fault


@pytest.mark.journey
def test_without_its_certificate_a_campaign_says_what_it_computes(
    started: Processes, calm: Path, tmp_path: Path
) -> None:
    """As after a kill between the last test and the certificate: no worker is needed, and none waits for anything."""
    directory = Path(shutil.copytree(calm, tmp_path / "run"))
    before = (directory / "certificate.json").read_bytes()
    (directory / "certificate.json").unlink()
    resumed = started.run("perfbound", "resume", directory)
    assert resumed.code == 0, resumed.err
    assert "every test is done; computing the claims, their audit and the certificate" in resumed.err
    assert "waiting" not in resumed.err
    assert (directory / "certificate.json").read_bytes() == before
