"""`perfbound replay` of a real campaign, with a real child that simulates."""

import shutil
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, contents

ROLLOUT = "sim_gap.3.true.0"
FILE = f"trajectories/sim_gap/0/{ROLLOUT}.mcap"


@pytest.mark.journey
def test_a_rollout_is_simulated_again(started: Processes, calm: Path, tmp_path: Path) -> None:
    before = contents(calm)
    for name in ("one", "two"):
        files = ("--out", tmp_path / f"{name}.png", "--mcap", tmp_path / f"{name}.mcap")
        ended = started.run("perfbound", "replay", calm, ROLLOUT, *files)
        assert (ended.code, ended.err) == (0, "")
        assert ended.out.splitlines()[1:] == [
            "bitwise the same as the recorded trajectory",
            f"file: {tmp_path / name}.mcap",
            f"picture: {tmp_path / name}.png",
        ]
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "one.mcap").read_bytes() == (calm / FILE).read_bytes(), "this campaign shows everything"
    assert contents(calm) == before, "the campaign is as it was"


def test_a_damaged_file_is_said_to_be_damaged(started: Processes, calm: Path, tmp_path: Path) -> None:
    directory = shutil.copytree(calm, tmp_path / "run")
    (directory / FILE).write_bytes(b"")
    ended = started.run("perfbound", "replay", directory, ROLLOUT)
    assert (ended.code, ended.err) == (0, "")
    _, damage, good = ended.out.splitlines()
    assert damage.startswith(f"{directory / FILE}: sha256 ")
    assert good == "simulated again, the file is bitwise the same as the recorded one"


def test_known_faults_are_one_line(started: Processes, calm: Path, tmp_path: Path) -> None:
    ended = started.run("perfbound", "replay", calm, "sim_gap.3.true.9")
    assert (ended.code, ended.out) == (1, "")
    assert ended.fault == (
        f"perfbound: {calm}: no rollout sim_gap.3.true.9 is recorded; "
        "choose one of its test: sim_gap.3.nominal.0, sim_gap.3.true.0"
    )
    ended = started.run("perfbound", "replay", tmp_path, ROLLOUT)
    assert (ended.code, "no campaign here" in ended.fault) == (1, True)
    (tmp_path / "file").touch()
    ended = started.run("perfbound", "replay", calm, ROLLOUT, "--out", tmp_path / "file" / "a.png")
    assert (ended.code, "a.png" in ended.fault or "file" in ended.fault) == (1, True)
