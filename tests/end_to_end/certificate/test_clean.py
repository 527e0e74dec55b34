"""`perfbound clean`: it says what goes, asks, and removes that alone."""

import os
import shutil
import time
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes

SAMPLE = Path(__file__).parents[2] / "fixtures" / "finished" / "sample"


@pytest.mark.journey
def test_old_runs_go_and_signed_ones_stay(started: Processes) -> None:
    then = time.time() - 40 * 86_400
    for name in ("old", "signed", "new"):
        shutil.copytree(SAMPLE, started.folder / "runs" / name)
    assert started.run("perfbound", "keygen", "alice", "--out", ".").code == 0
    assert started.run("perfbound", "sign", "runs/signed", "--key", "alice.key").code == 0
    for name in ("old", "signed"):
        os.utime(started.folder / "runs" / name / "campaign.db", (then, then))
    line = ("perfbound", "clean", "runs", "--older", "30d")
    listed = started.run(*line, "--dry-run")
    assert listed.code == 0
    assert "1 run of 3 can go, which frees " in listed.out
    assert "stays: 1 run, signed" in listed.out
    asked = started.run(*line)
    assert asked.code == 2
    assert "there is no terminal to ask" in asked.err
    verified = started.run(*line, "--keep-verified", "--yes")
    assert "0 runs of 3 can go" in verified.out
    assert (started.folder / "runs" / "old").exists()
    removed = started.run(*line, "--yes")
    assert removed.code == 0
    assert "removed runs/old" in removed.out
    assert sorted(path.name for path in (started.folder / "runs").iterdir()) == ["new", "signed"]
    assert started.run("perfbound", "verify", "runs/signed").code == 0
