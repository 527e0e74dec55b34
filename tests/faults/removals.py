"""Files of a run directory that are removed, cut or replaced while its campaign runs."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

from tests.end_to_end.processes import recorded
from tests.faults.scene import Scene

DATABASE = ("campaign.db", "campaign.db-wal", "campaign.db-shm")


def lost_evidence(scene: Scene) -> None:
    """Trajectory files are removed or cut: simulated again before the certificate, or no certificate and a resume."""
    scene.start()
    times = scene.chance.choice((1, 2, 3))
    for moment in scene.moments(times, share=0.9):
        if not scene.reach(moment) and not _without_certificate(scene):
            break
        scene.pause()
        scene.did(f"{_damage(scene)} at {recorded(scene.directory)} rollouts")
    for _ in range(times):
        if not _without_certificate(scene):
            break
    scene.finish()


def _damage(scene: Scene) -> str:
    """Damage trajectory files; return what was done to how many."""
    folder = scene.directory / "trajectories"
    files = sorted(folder.rglob("*.mcap"))
    if scene.chance.random() < 0.2:
        shutil.rmtree(folder, ignore_errors=True)  # a file may come into it meanwhile
        return f"removed the folder of {len(files)} files"
    chosen = scene.chance.sample(files, min(len(files), scene.chance.choice((1, 1, 3))))
    if scene.chance.random() < 0.5:
        for file in chosen:
            file.unlink()
        return f"removed {len(chosen)} files"
    for file in chosen:
        os.truncate(file, scene.chance.randrange(file.stat().st_size))
    return f"cut {len(chosen)} files"


def _without_certificate(scene: Scene) -> bool:
    """Wait for the end; resume a campaign that has ended in one line and without a certificate."""
    if scene.end().code == 0:
        return False
    last = scene.refused()
    assert not (scene.directory / "certificate.json").exists(), last
    assert "trajectories" in last, last
    scene.resume()
    return True


def lost_database(scene: Scene) -> None:
    """The database is moved, removed or replaced: no certificate; after the right one is back, it resumes."""
    scene.start()
    early, late = scene.moments(2, share=0.6)
    backup = scene.folder / "backup.db"
    if scene.reach(early):
        with (
            closing(sqlite3.connect(scene.directory / "campaign.db")) as source,
            closing(sqlite3.connect(backup)) as to,
        ):
            source.backup(to)
    if scene.reach(late):
        scene.pause()
        kind = scene.chance.choice(("moved", "removed", "replaced by an older one", "replaced by another campaign's"))
        scene.did(f"database {kind} at {recorded(scene.directory)} rollouts")
        aside = _take_away(scene, kind, backup)
        last = scene.refused()
        assert "campaign.db" in last, last
        for name in ("certificate.json", "manifest.sha256"):
            assert not (scene.directory / name).exists(), name
        for name in DATABASE:
            (scene.directory / name).unlink(missing_ok=True)
        for name in os.listdir(aside):
            shutil.move(aside / name, scene.directory / name)
        scene.did("the right database back", fault=False)
        scene.resume()
    scene.finish()


def _take_away(scene: Scene, kind: str, backup: Path) -> Path:
    """Take the database away; return the folder of the right one."""
    aside = scene.folder / "aside"
    aside.mkdir()
    if kind == "moved":
        for name in DATABASE:
            (scene.directory / name).rename(aside / name)
        return aside
    shutil.copy(backup, aside / "campaign.db")
    if kind == "removed":
        for name in DATABASE:
            (scene.directory / name).unlink()
    else:
        wrong = backup if "older" in kind else scene.subject.calm / "campaign.db"
        shutil.copy(wrong, scene.folder / "wrong.db")
        (scene.folder / "wrong.db").replace(scene.directory / "campaign.db")
    return aside
