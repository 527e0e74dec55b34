"""Methods `rigorous`, `kriging` and `scenario` on the real Segway: the same bytes whatever happens."""

import random
from pathlib import Path

import pytest

from tests.campaigns import FOLDER, PAIR
from tests.end_to_end.processes import Processes, recorded, wait_for

SMALL = {
    PAIR: {
        "resolution = 26": "resolution = 7",
        "max_tests = 400": "max_tests = 6",
        "max_tests = 100": "max_tests = 3",
    }
    | {"replicates = 64": "replicates = 5"},
    FOLDER / "segway-rigorous.toml": {
        "resolution = 41": "resolution = 9",
        "max_tests = 100": "max_tests = 6",
        "replicates = 64": "replicates = 4",
    },
    FOLDER / "segway-scenario.toml": {"max_tests = 750": "max_tests = 10", "replicates = 8": "replicates = 3"},
}


@pytest.mark.parametrize("source", SMALL, ids=lambda source: source.stem)
def test_workers_and_kills_change_no_byte(started: Processes, tmp_path: Path, source: Path) -> None:
    text = source.read_text()
    for old, new in SMALL[source].items():
        assert old in text
        text = text.replace(old, new)
    campaign = tmp_path / "c.toml"
    campaign.write_text(f"spot_check = 6\nspot_check_followups = 4\nrecheck = 3\n{text}")
    ended = started.run("perfbound", "run", campaign, "--out", "calm", "--workers", "3")
    assert ended.code == 0, ended.err
    assert "CLAIM  rho*" in ended.out
    assert "REFUTED" not in ended.out
    directory, rng = tmp_path / "killed", random.Random(source.stem)
    first = started.start("perfbound", "run", campaign, "--out", directory, "--workers", "1")
    goal = rng.randint(1, 8)
    wait_for(lambda: recorded(directory) >= goal)
    assert first.running, "the kill has to come in mid-run"
    first.popen.kill()
    first.wait()
    assert not (directory / "certificate.json").exists()
    assert started.run("perfbound", "resume", directory).code == 0
    assert (directory / "certificate.json").read_bytes() == (tmp_path / "calm" / "certificate.json").read_bytes()


@pytest.mark.journey
def test_strict_exits_with_3_when_the_first_claim_rests_on_a_refuted_assumption(started: Processes, calm: Path) -> None:
    assert started.run("perfbound", "resume", calm).code == 0
    assert started.run("perfbound", "resume", calm, "--strict").code == 3
