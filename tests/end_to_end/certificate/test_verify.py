"""`perfbound verify` as a sceptic uses it: real runs, real simulations, exit codes."""

import json
import shutil
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes


@pytest.fixture
def copy(calm: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(calm, tmp_path / "run"))


@pytest.mark.journey
def test_a_real_campaign_with_random_rollouts_simulated_again(started: Processes, copy: Path) -> None:
    ended = started.run("perfbound", "verify", copy, "--resimulate", "4")
    assert ended.code == 0, ended.out + ended.err
    assert "\nVERIFIED (the signature was not checked): " in ended.out
    assert "bitwise the same: workers_honest is sampled" in " ".join(ended.out.split())
    assert "CLAIM" in ended.out


def test_a_damaged_one_says_where_and_exits_with_1(started: Processes, copy: Path) -> None:
    victim = sorted((copy / "trajectories").rglob("*.mcap"))[5]
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    ended = started.run("perfbound", "verify", copy, "--json")
    assert ended.code == 1
    found = json.loads(ended.out)
    assert found["verified"] is False
    checks = {check["check"]: check for check in found["checks"]}
    assert checks["files"]["status"] == "failed"
    assert victim.name in checks["files"]["detail"]
    assert checks["audit"]["status"] == "skipped"


@pytest.mark.journey
def test_signed_and_verified_with_the_public_key(started: Processes, copy: Path, tmp_path: Path) -> None:
    for name in ("ours", "theirs"):
        assert started.run("perfbound", "keygen", name, "--out", tmp_path).code == 0
    assert started.run("perfbound", "sign", copy, "--key", tmp_path / "ours.key").code == 0
    good = started.run("perfbound", "verify", copy, "--key", tmp_path / "ours.pub")
    assert good.code == 0, good.out + good.err
    wrong = started.run("perfbound", "verify", copy, "--key", tmp_path / "theirs.pub")
    assert wrong.code == 1
    assert "NOT VERIFIED" in wrong.out


def test_an_unfinished_campaign_has_nothing_to_verify(started: Processes, tmp_path: Path) -> None:
    ended = started.run("perfbound", "verify", tmp_path)
    assert ended.code == 1
    assert "no certificate here" in ended.fault
