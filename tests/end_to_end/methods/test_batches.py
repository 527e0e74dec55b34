"""Batches with real workers: the same bytes for any number of them and after kill -9, and a check that repeats some."""

import json
import random
import re
import shlex
from functools import partial
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, query, wait_for

SYSTEM = '''import numpy as np
import perfbound as pb


@pb.system(parameters={"a": pb.Parameter(0, 1, unit="m")}, columns={"x": "m"}, step=0.05, vectorised=True)
def drift(a, *, seeds, horizon=1.0):
    """A level with noise."""
    return a[:, np.newaxis] + 0.1 * pb.normal(seeds, int(horizon / 0.05) + 1)
'''
MODEL = """seed = 5
horizon = 1.0
clip = [-1.0, 2.0]
system = { python = "drift.py:drift" }
space = { a = { low = 0, high = 1 } }
"""
CAMPAIGN = f"""name = "drift"
{MODEL}specification = "always (x > -0.2)"
batch = 32
claims = [{{ quantity = "failure_probability", delta = 0.05 }}, {{ quantity = "mean", delta = 0.05 }}]

[[problems]]
name = "robustness"
method = "sample"
max_tests = 6000
"""


def write(folder: Path) -> Path:
    (folder / "drift.py").write_text(SYSTEM)
    campaign = folder / "c.toml"
    campaign.write_text(CAMPAIGN)
    return campaign


COUPLED = SYSTEM.replace("True)", "True, batch_is_the_unit=True)").replace(
    "return a[:, np.newaxis]", "return a[:, np.newaxis] * (1 + 1e-12 * np.arange(len(a))[:, np.newaxis])"
)
"""The last digits depend on the place in the batch, as where a compiler unrolls a loop."""


def recorded(directory: Path) -> int:
    return sum(int(str(number)) for (number,) in query(directory, "SELECT rollouts FROM rollouts"))


def test_workers_and_kills_change_no_byte(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path)
    ended = started.run("perfbound", "run", campaign, "--out", "calm", "--workers", "3")
    assert ended.code == 0, ended.err
    assert "6,000 rollouts" in ended.out
    directory, rng = tmp_path / "killed", random.Random(1)
    first = started.start("perfbound", "run", campaign, "--out", directory, "--workers", "1")
    goal = rng.randint(100, 1500)
    wait_for(lambda: recorded(directory) >= goal)
    first.popen.kill()
    first.wait()
    assert not (directory / "certificate.json").exists(), "the kill has to come in mid-run"
    assert started.run("perfbound", "resume", directory).code == 0
    certificate = (tmp_path / "calm" / "certificate.json").read_bytes()
    assert (directory / "certificate.json").read_bytes() == certificate
    assert recorded(directory) == 6000 + 20
    files = list((directory / "trajectories").rglob("*.mcap"))
    assert len(files) == -(-6000 // 32) + 20, "one file for each batch, and one for each rollout that is repeated"
    checked = started.run("perfbound", "verify", "calm", "--resimulate", "40", "--system", tmp_path / "drift.py:drift")
    assert checked.code == 0, checked.out + checked.err
    assert "VERIFIED" in checked.out


IN_PART = SYSTEM.replace("return a[", "return np.where((len(a) > 1) & (seeds % 7 == 0), np.nan, a)[")
"""In a batch some rollouts fail, always the same ones, and alone they succeed."""


def test_batches_that_fail_in_part_have_one_certificate(started: Processes, tmp_path: Path) -> None:
    """Neither workers nor kills decide which rollouts are made again, or in which files they are."""
    campaign = write(tmp_path)
    campaign.write_text(CAMPAIGN.replace("6000", "2000"))
    (tmp_path / "drift.py").write_text(IN_PART)
    assert started.run("perfbound", "run", campaign, "--out", "one", "--workers", "1").code == 0
    assert started.run("perfbound", "run", campaign, "--out", "three", "--workers", "3").code == 0
    directory = tmp_path / "killed"
    run: tuple[str | Path, ...] = ("run", campaign, "--out", directory, "--workers", "2")
    for goal in (200, 1200):
        running = started.start("perfbound", *run)
        wait_for(partial(has_rollouts, directory, goal))
        running.popen.kill()
        running.wait()
        assert not (directory / "certificate.json").exists(), "the kills have to come in mid-run"
        run = ("resume", directory, "--workers", "2")
    assert started.run("perfbound", *run).code == 0
    for name in ("certificate.json", "manifest.sha256"):
        assert len({(tmp_path / run / name).read_bytes() for run in ("one", "three", "killed")}) == 1
    again = [path for path in (tmp_path / "one" / "trajectories").rglob("*.1.mcap") if path.stem.count(".") == 4]
    assert len(again) > 200
    assert statuses(directory)["reproducible_rollouts"][0] == "refuted"
    checked = started.run("perfbound", "verify", "one")
    assert checked.code == 0, checked.out + checked.err


def has_rollouts(directory: Path, number: int) -> bool:
    return recorded(directory) >= number


UNIT = SYSTEM.replace("vectorised", "batch_is_the_unit=True, vectorised").replace("return a", "return len(a) + a")


@pytest.mark.parametrize("system", [SYSTEM, UNIT], ids=["alone", "as a batch"])
def test_a_rollout_of_a_batch_is_replayed(started: Processes, tmp_path: Path, system: str) -> None:
    campaign = write(tmp_path)
    (tmp_path / "drift.py").write_text(system)
    text = campaign.read_text().replace("6000", "100").replace("x > -0.2", "x > 0.2")
    campaign.write_text("recheck = 0\n" + text.replace("batch = 32", "batch = 16"))
    assert started.run("perfbound", "run", campaign, "--out", "run", "--workers", "1").code == 0
    for rollout in ("robustness.0.nominal.0", "robustness.37.nominal.0", "robustness.99.nominal.0"):
        system_file = tmp_path / "drift.py:drift"
        ended = started.run("perfbound", "replay", "run", rollout, "--mcap", "a.mcap", "--system", system_file)
        assert (ended.code, ended.err) == (0, "")
        assert ended.out.splitlines()[1:] == ["bitwise the same as the recorded trajectory", "file: a.mcap"]
    if system == SYSTEM:
        found = re.search(r"Repeat the worst: (perfbound replay .*)", started.run("perfbound", "status", "run").out)
        assert found is not None
        assert started.run(*shlex.split(found[1])).code == 0


def statuses(directory: Path) -> dict[str, tuple[str, str | None]]:
    found = json.loads((directory / "certificate.json").read_text())["predicate"]["assumptions"]
    return {each["id"]: (each["status"], each.get("form")) for each in found}


def test_where_the_batch_is_the_unit_whole_batches_are_repeated(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path)
    campaign.write_text(CAMPAIGN.replace("6000", "600"))
    for directory, code, status, form in (
        ("alone", COUPLED.replace(", batch_is_the_unit=True", ""), "refuted", None),
        ("whole", COUPLED, "not refuted", "reproducible_batches"),
    ):
        (tmp_path / "drift.py").write_text(code)
        ended = started.run("perfbound", "run", campaign, "--out", directory, "--workers", "1")
        assert (tmp_path / directory / "certificate.json").exists(), ended.err
        assert statuses(tmp_path / directory)["reproducible_rollouts"] == (status, form)
    verify = ("perfbound", "verify", "whole", "--resimulate", "30", "--system", tmp_path / "drift.py:drift")
    checked = started.run(*verify)
    assert checked.code == 0, checked.out + checked.err
    assert "30 of 39 files, bitwise the same" in checked.out


def test_where_the_batch_is_the_unit_a_failed_rollout_is_that_of_its_batch(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path)
    (tmp_path / "drift.py").write_text(COUPLED.replace("np.newaxis] *", "np.newaxis] / (a < 0.999)[:, np.newaxis] *"))
    ended = started.run("perfbound", "run", campaign, "--out", "run", "--workers", "1")
    assert ended.code != 0
    assert "the whole batch failed with a = 0.999" in ended.err
    assert recorded(tmp_path / "run") % 32 == 0


def test_the_worst_alone_keep_their_samples(started: Processes, tmp_path: Path) -> None:
    """Neither workers nor a kill decide which; what is gone can be simulated again."""
    campaign = write(tmp_path)
    campaign.write_text('keep = "worst 30"\n' + CAMPAIGN)
    assert started.run("perfbound", "run", campaign, "--out", "calm", "--workers", "3").code == 0
    directory = tmp_path / "killed"
    first = started.start("perfbound", "run", campaign, "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 1000)
    first.popen.kill()
    first.wait()
    assert started.run("perfbound", "resume", directory).code == 0
    certificate = (tmp_path / "calm" / "certificate.json").read_bytes()
    assert (directory / "certificate.json").read_bytes() == certificate
    for path in (directory / "trajectories").rglob("*.mcap"):
        assert path.read_bytes() == (tmp_path / "calm" / path.relative_to(directory)).read_bytes()
    given = ("--system", tmp_path / "drift.py:drift")
    checked = started.run("perfbound", "verify", "calm", "--resimulate", "40", *given)
    assert checked.code == 0, checked.out + checked.err
    assert "40 of 208 files, bitwise the same" in checked.out
    # The last blocks were proposed when many were closed.
    ended = started.run("perfbound", "replay", "calm", "robustness.5999.nominal.0", "--mcap", "a.mcap", *given)
    assert ended.code == 0, ended.out + ended.err
    assert "its samples were not kept" in ended.out
    assert "the trajectory is bitwise the same as the recorded one" in ended.out


FRESH = SYSTEM.replace("import", "import time\nimport", 1).replace("return a", "time.sleep(0.03)\n    return a")
BOUNDED = f"""name = "fresh"
{MODEL}specification = "x > -0.2"
batch = 16
spot_check_followups = 60

[[problems]]
name = "robustness"
method = "kriging"
rkhs_norm = 1.0
max_tests = 64
kernel = {{ nu = 2.5, length_scale = 0.7 }}
"""


def test_a_spot_check_in_batches_survives_kills(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path)
    (tmp_path / "drift.py").write_text(FRESH.replace("0.1 *", "1.0 *"))
    campaign.write_text(BOUNDED)
    calm = started.run("perfbound", "run", campaign, "--out", "calm", "--workers", "3")
    assert calm.code == 0, calm.err
    files = [path.stem.split(".") for path in (tmp_path / "calm" / "trajectories").rglob("spot_check.*.mcap")]
    batches = [each for each in files if len(each) == 5]
    assert len(batches) == 19, "299 starts in batches of 16"
    assert len(files) > len(batches), "a follow-up is a file of its own"
    directory = tmp_path / "killed"
    run: tuple[str | Path, ...] = ("run", campaign, "--out", directory, "--workers", "1")
    for goal in (5, 19 + 8):
        running = started.start("perfbound", *run)
        wait_for(partial(reached, directory, goal))
        running.popen.kill()
        running.wait()
        run = ("resume", directory, "--workers", "2")
    assert not (directory / "certificate.json").exists(), "the kills have to come in mid-check"
    assert started.run("perfbound", *run).code == 0
    certificate = (tmp_path / "calm" / "certificate.json").read_bytes()
    assert (directory / "certificate.json").read_bytes() == certificate
    verify = ("perfbound", "verify", "calm", "--resimulate", "30", "--system", tmp_path / "drift.py:drift")
    checked = started.run(*verify)
    assert checked.code == 0, checked.out + checked.err


def reached(directory: Path, files: int) -> bool:
    return len(query(directory, "SELECT seq FROM rollouts WHERE problem = 'spot_check'")) >= files
