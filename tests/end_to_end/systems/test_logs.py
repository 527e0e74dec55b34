"""Logs that exist: rollouts of a simulation, written as others write them, give the claim of the simulation."""

import csv
import json
import os
import signal
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from tests.end_to_end.processes import processes, wait_for
from tests.fakes.logs import write_csv, write_json_mcap

CARS = Path(__file__).parents[3] / "deploy" / "examples" / "cars" / "cars.py"
TESTS = 200
COMMON = """
specification = "always (distance >= 2)"
horizon = 8.0
clip = [-20, 60]
[space]
gap = [5, 50]
speed = [10, 30]
[system]
"""
SIMULATED = f'method = "sample"\nmax_tests = {TESTS}\nrecheck = 0\n{COMMON}python = "cars.py:cars"\n'
RIG = COMMON + 'rig = "test-car"\ncolumns = { distance = "m", speed = "m/s" }\n'
OF_TOPICS = RIG + '[system.logs]\ncolumns = { distance = "/radar.range", speed = "/odom.linear.x" }\noffset = "first"\n'


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with 200 simulated rollouts as logs, in two forms, and what the simulation claims."""
    folder = tmp_path_factory.mktemp("logs")
    (folder / "cars.py").write_bytes(CARS.read_bytes())
    (folder / "simulated.toml").write_text(SIMULATED)
    with processes(folder) as started:
        assert started.run("perfbound", "run", "simulated.toml").code == 0
    run = pb.open(folder / "runs" / "simulated")
    rows = []
    for kind in ("csv", "mcap"):
        (folder / kind).mkdir()
    for row in run.tests:
        number, trajectory = int(row["test"]), run.trajectory(int(row["test"]))
        t, distance, speed = (trajectory.column(name) for name in ("t", "distance", "speed"))
        write_csv(folder / "csv" / f"{number:03}.csv", {"t": t, "distance": distance, "speed": speed})
        write_json_mcap(folder / "mcap" / f"{number:03}.mcap", t, distance, speed)
        rows.append((f"{number:03}", float(row["gap"]), float(row["speed"])))
    for kind in ("csv", "mcap"):
        columns: dict[str, Any] = {
            "log": [f"{name}.{kind}" for name, _, _ in rows],
            "gap": [gap for _, gap, _ in rows],
            "speed": [speed for _, _, speed in rows],
        }
        write_csv(folder / f"{kind}-starts.csv", columns)
    (folder / "csv.toml").write_text(RIG)
    (folder / "mcap.toml").write_text(OF_TOPICS)
    return folder


@pytest.fixture
def own(simulated: Path, tmp_path: Path) -> Path:
    """Return the folder with files of its own, whose logs are links."""
    for each in simulated.iterdir():
        if each.is_file():
            (tmp_path / each.name).write_bytes(each.read_bytes())
    for kind in ("csv", "mcap"):
        (tmp_path / kind).mkdir()
        for each in (simulated / kind).iterdir():
            (tmp_path / kind / each.name).symlink_to(each)
    return tmp_path


def import_command(kind: str) -> tuple[str, ...]:
    return ("import", kind, "--starts", f"{kind}-starts.csv", "--campaign", f"{kind}.toml")


def claim_in(run: Path) -> dict[str, Any]:
    certificate = json.loads((run / "certificate.json").read_text())
    found: dict[str, Any] = certificate["predicate"]["claims"][0]
    return {key: found[key] for key in ("bound", "probability", "quantity", "samples")}


def robustness(run: Path) -> list[float]:
    return [float(each) for each in pb.open(run).tests["observation"]]


@pytest.mark.parametrize("kind", [pytest.param("csv", marks=pytest.mark.journey), "mcap"])
def test_logs_give_the_claim_of_their_simulation(simulated: Path, tmp_path: Path, kind: str) -> None:
    with processes(tmp_path) as started:
        command = [str(simulated / each) if "." in each or each == kind else each for each in import_command(kind)]
        ended = started.run("perfbound", *command, "--out", "run")
        assert ended.code == 0, ended.err
        assert "CLAIM" in ended.out
        checked = started.run("perfbound", "verify", "run")
        assert "VERIFIED" in checked.out, checked.out
    assert claim_in(tmp_path / "run") == claim_in(simulated / "runs" / "simulated")
    expected = robustness(simulated / "runs" / "simulated")
    np.testing.assert_allclose(robustness(tmp_path / "run"), expected, rtol=0, atol=1e-12)


def test_nothing_is_imported_of_logs_of_which_three_are_broken(own: Path) -> None:
    """A line for each, with its file; no run directory; and with the logs repaired the same call succeeds."""
    names = ("007.csv", "050.csv", "199.csv")
    whole = {name: (own / "csv" / name).read_text() for name in names}
    for name in names:
        (own / "csv" / name).unlink()
    lines = whole["007.csv"].splitlines()
    (own / "csv" / "007.csv").write_text("\n".join([*lines[:10], lines[11], lines[10], *lines[12:]]))
    (own / "csv" / "050.csv").write_text(whole["050.csv"][: len(whole["050.csv"]) // 2])
    (own / "csv" / "199.csv").write_text(whole["199.csv"].replace("distance", "dist", 1))
    with processes(own / "p") as started:
        started.folder = own
        ended = started.run("perfbound", *import_command("csv"))
        assert ended.code == 1
        found = ended.err.splitlines()
        assert [Path(line.split(": ")[1]).name for line in found] == list(names)
        assert not (own / "runs").exists()
        for name, text in whole.items():
            (own / "csv" / name).write_text(text)
        assert started.run("perfbound", *import_command("csv")).code == 0


def test_a_test_that_has_no_row_is_refused(own: Path) -> None:
    """To leave out a log would be a choice by its outcome; and one log cannot count twice."""
    starts = own / "csv-starts.csv"
    rows = list(csv.reader(starts.read_text().splitlines()))
    with processes(own / "p") as started:
        started.folder = own
        starts.write_text("\n".join(",".join(row) for row in rows[:-1]))
        left_out = started.run("perfbound", *import_command("csv")).fault
        assert "csv/199.csv: csv-starts.csv has no row for this log" in left_out
        (own / "csv" / "200.csv").write_bytes((own / "csv" / "003.csv").read_bytes())
        starts.write_text("\n".join(",".join(row) for row in [*rows, ["200.csv", *rows[4][1:]]]))
        assert "csv/200.csv: the same log as 003.csv" in started.run("perfbound", *import_command("csv")).fault
        (own / "csv" / "200.csv").unlink()
        starts.write_text("\n".join(",".join(row) for row in [rows[0], ["000.csv", "4", "20"], *rows[2:]]))
        outside = started.run("perfbound", *import_command("csv")).fault
        assert "space.gap: test 1, 000.csv, was driven from 4, outside [5, 50]" in outside


def test_logs_without_a_horizon_are_refused_in_one_line(own: Path) -> None:
    """Else the first sample of each would be all that is judged."""
    (own / "csv.toml").write_text((own / "csv.toml").read_text().replace("horizon = 8.0\n", ""))
    with processes(own / "p") as started:
        started.folder = own
        fault = started.run("perfbound", *import_command("csv")).fault
    assert "000.csv and 199 further logs: it has 161 samples of distance over 8 s, and the campaign no horizon" in fault
    assert not (own / "runs").exists()


def test_tests_that_share_a_part_of_a_log_are_refused(own: Path) -> None:
    rows = ["log,gap,speed,offset", "000.csv,20,20,0", "000.csv,21,20,3.5", "000.csv,22,20,7.5"]
    (own / "few.csv").write_text("\n".join(rows))
    (own / "one").mkdir()
    (own / "one" / "000.csv").symlink_to(own / "csv" / "000.csv")
    (own / "csv.toml").write_text((own / "csv.toml").read_text().replace("horizon = 8.0", "horizon = 4.0"))
    with processes(own / "p") as started:
        started.folder = own
        fault = started.run("perfbound", "import", "one", "--starts", "few.csv", "--campaign", "csv.toml").fault
    assert "one/000.csv: the tests at 0 and 3.5 s overlap, since each lasts 4 s" in fault


def test_an_import_that_is_killed_continues(simulated: Path, own: Path) -> None:
    database = own / "runs" / "csv" / "campaign.db"

    def recorded() -> int:
        try:
            with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
                return int(connection.execute("SELECT count(*) FROM rollouts").fetchone()[0])
        except sqlite3.Error:
            return 0

    with processes(own / "p") as started:
        started.folder = own
        first = started.start("perfbound", *import_command("csv"))
        wait_for(lambda: recorded() >= 20)
        os.kill(first.pid, signal.SIGKILL)
        first.popen.wait()
        assert 20 <= recorded() < TESTS
        assert not (own / "runs" / "csv" / "certificate.json").exists()
        assert started.run("perfbound", *import_command("csv")).code == 0
    assert claim_in(own / "runs" / "csv") == claim_in(simulated / "runs" / "simulated")
    assert recorded() == TESTS


def test_starts_of_another_law_are_refuted(own: Path) -> None:
    """Logs of a test engineer who drove more of the hard ones."""
    starts = own / "csv-starts.csv"
    rows = list(csv.reader(starts.read_text().splitlines()))
    text = (own / "csv.toml").read_text()
    (own / "csv.toml").write_text(text.replace("gap = [5, 50]", 'gap = { low = 5, high = 100, unit = "m" }'))
    starts.write_text("\n".join(",".join(row) for row in rows))
    with processes(own / "p") as started:
        started.folder = own
        ended = started.run("perfbound", *import_command("csv"), "--strict")
        assert ended.code == 3, ended.err
        shown = started.run("perfbound", "show", "runs/csv", "--assumptions").out
        assert "the starts of the logs do not have the distribution under [space]: gap" in " ".join(shown.split())


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ('method = "rigorous"\nalpha = 1.0\nrkhs_norm = 5\nnoise_scale = "derived"', "chooses its starts, and logs"),
        ("max_tests = 100", "there are 200 logs, and to leave some out would be a choice"),
        ("until_counterexample = true", "all logs are there before the first one is read"),
        ("recheck = 5", "recheck"),
    ],
)
def test_what_would_choose_among_the_logs_is_refused(own: Path, key: str, words: str) -> None:
    (own / "csv.toml").write_text(f"{key}\n{(own / 'csv.toml').read_text()}")
    with processes(own / "p") as started:
        started.folder = own
        assert words in started.run("perfbound", *import_command("csv")).fault
