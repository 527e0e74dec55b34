"""Evidence and database that are removed while a campaign runs; symbolic links in its directory."""

import os
import shutil
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.run.certify import certify
from perfbound.orchestrator.run.service import Service
from perfbound.orchestrator.store import files as evidence
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas import atomic
from perfbound.schemas.errors import EvidenceError, JournalError
from perfbound.schemas.ids import FileId, RolloutId
from tests.facts import facts
from tests.fakes.finished import a_pair, finish, play
from tests.fakes.puppets import Stage

CONFIG = a_pair("paper", recheck=2)
LOST = evidence.relative_path(FileId(RolloutId("sim_gap", 2, "true", 0)))


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The certificate of the undisturbed campaign."""
    directory = tmp_path_factory.mktemp("calm") / "run"
    finish(play(directory, CONFIG), directory)
    return (directory / files.CERTIFICATE).read_text()


@pytest.mark.parametrize(
    "damage", [Path.unlink, lambda path: path.write_bytes(bytes(path.stat().st_size))], ids=["removed", "changed"]
)
def test_a_file_that_is_lost_in_mid_run_is_simulated_again(
    tmp_path: Path, calm: str, damage: Callable[[Path], None]
) -> None:
    directory = tmp_path / "run"
    stage = Stage(directory, CONFIG, 3)
    service = Service(stage.ledger, stage.journal, stage.puppets, None, [], resumed=False)
    stage.puppets.start(stage.journal.header.run, service.inbox.put)
    service.run()
    damage(directory / LOST)
    assert stage.ledger.check_files(stage.journal, whole=True) == 1
    assert not stage.ledger.done
    service.run()
    assert stage.ledger.check_files(stage.journal, whole=True) == 0
    certify(directory, stage.ledger)
    stage.journal.close()
    assert (directory / files.CERTIFICATE).read_text() == calm


@pytest.mark.parametrize("replaced", [False, True])
def test_a_database_that_is_lost_in_mid_run_ends_the_campaign(tmp_path: Path, replaced: bool) -> None:
    directory = tmp_path / "run"
    stage = Stage(directory, CONFIG, 3)
    stage.puppets.holding = True  # so that it does not end before

    def lose() -> bool:
        if replaced:
            shutil.copy(directory / DATABASE, tmp_path / "copy")
            (tmp_path / "copy").replace(directory / DATABASE)
        else:
            (directory / DATABASE).unlink()
        return False

    with pytest.raises(JournalError, match=facts("campaign.db: campaign running")):
        stage.play(lose)
    stage.journal.close()
    assert files.read(directory) is None


# Symbolic links


@pytest.mark.parametrize("level", ["trajectories", "trajectories/sim_gap", "trajectories/sim_gap/0"])
def test_nothing_is_written_or_removed_through_a_link(tmp_path: Path, level: str) -> None:
    directory, outside = tmp_path / "run", tmp_path / "outside"
    play(directory, CONFIG).journal.close()
    shutil.move(directory / level, outside)
    (directory / level).symlink_to(outside)
    foreign = outside / "foreign.mcap"
    foreign.write_bytes(b"not ours")
    with closing(Journal.open(directory)) as journal:
        ledger = Ledger(directory, journal)
        ledger.replay()
        with pytest.raises(EvidenceError, match=facts("link folder")):
            ledger.check_files(journal)
    assert foreign.read_bytes() == b"not ours"
    with pytest.raises(EvidenceError, match="a symbolic link"):
        evidence.inside(directory, LOST)


def test_the_run_directory_itself_may_be_a_link(tmp_path: Path, calm: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "elsewhere")
    finish(play(tmp_path / "run", CONFIG), tmp_path / "run")
    assert (tmp_path / "elsewhere" / files.CERTIFICATE).read_text() == calm


@pytest.mark.parametrize("name", [DATABASE, f"{DATABASE}-wal", f"{DATABASE}-shm", f"{DATABASE}-journal"])
def test_a_database_behind_a_link_is_not_opened_for_writing(tmp_path: Path, name: str) -> None:
    play(tmp_path / "run", CONFIG).journal.close()
    outside = tmp_path / "outside"
    if (tmp_path / "run" / name).exists():
        (tmp_path / "run" / name).rename(outside)
    (tmp_path / "run" / name).symlink_to(outside)
    with pytest.raises(JournalError, match="a symbolic link"):
        Journal.open(tmp_path / "run")


def test_a_half_written_file_that_is_a_link_is_replaced(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_bytes(b"not ours")
    path, batch = tmp_path / "run" / "file.mcap", evidence.Batch()
    path.parent.mkdir()
    atomic.temporary(path).symlink_to(outside)
    atomic.write_whole(path, b"ours")
    assert path.read_bytes() == b"ours"
    atomic.temporary(path).symlink_to(outside)
    with batch:
        batch.write(path, b"ours too")
    assert path.read_bytes() == b"ours too"
    assert not path.is_symlink()
    atomic.temporary(path, f".{os.getpid()}").symlink_to(outside)
    with atomic.replacing([path]) as (file,):
        file.write(b"ours again")
    assert path.read_bytes() == b"ours again"
    assert outside.read_bytes() == b"not ours"
