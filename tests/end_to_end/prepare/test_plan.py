"""`perfbound plan`: what it foretells of campaigns that then run, its faults, and that it leaves nothing behind."""

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.campaigns import FOLDER, with_few_checks
from tests.end_to_end.processes import Processes, processes, query, wait_for

SYSTEM = """import time
import perfbound as pb

BOX = {"x": pb.Parameter(0, 5, unit="m")}

@pb.system(parameters=BOX, columns={"value": "m"})
def good(x):
    return 1.0 + x

@pb.system(parameters=BOX, columns={"value": "m"})
def failing(x):
    return 1 / (x - x)

@pb.system(parameters=BOX, columns={"value": "m"})
def slow(x):
    time.sleep(3600)
    return x
"""
CAMPAIGN = """horizon = 0
clip = [-1, 10]
specification = "always (value >= 0)"
max_tests = 40
system.python = "systems.py:{}"
space.x = [0, 5]
{}
[[problems]]
name = "robustness"
method = "sample"
delta = 0.05
"""


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as found:
        (tmp_path / "systems.py").write_text(SYSTEM)
        yield found


def campaign(started: Processes, system: str = "good", keys: str = "") -> Path:
    path = started.folder / f"{system}.toml"
    path.write_text(CAMPAIGN.format(system, keys))
    return path


def plan(started: Processes, path: Path, *options: str) -> dict[str, Any]:
    ended = started.run("perfbound", "plan", path, "--json", *options)
    assert (ended.code, ended.err) == (0, "")
    return dict(json.loads(ended.out))


def contains(guess: dict[str, float], value: float) -> bool:
    return guess["low"] <= value <= guess["high"]


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", ["test-function", "test-function-rigorous"])
def test_a_plan_contains_what_the_campaign_then_needs(started: Processes, name: str) -> None:
    path = with_few_checks(started.folder / "c.toml", name)
    found = plan(started, path, "--workers", "1")
    directory = started.folder / "run"
    assert started.run("perfbound", "run", path, "--workers", "1", "--out", directory).code == 0
    for each in (*found["problems"], *found["checks"]):
        rollouts = len(query(directory, f"SELECT 1 FROM rollouts WHERE problem = '{each['name']}'"))
        assert contains(each["tests"], rollouts / each["per_test"]), each
    assert contains(found["rollouts"], len(query(directory, "SELECT 1 FROM rollouts")))
    assert contains(found["files"], size(directory / "trajectories"))
    assert contains(found["storage"], size(directory))


def test_the_recheck_draws_from_the_spot_check_as_well(started: Processes) -> None:
    """12 tests of the problem, and over 300 rollouts of the spot check: 20 can be repeated."""
    text = (FOLDER / "test-function.toml").read_text().replace("max_tests = 1000", "max_tests = 12")
    path = started.folder / "few.toml"
    path.write_text(text)
    found = plan(started, path)
    (recheck,) = (each for each in found["checks"] if each["name"] == "recheck")
    assert recheck["tests"] == {"middle": 20, "low": 20, "high": 20}


def test_second_opinions_are_part_of_the_plan(started: Processes) -> None:
    plain = plan(started, campaign(started, keys="spot_check = 0"))
    compared = plan(started, campaign(started, keys="spot_check = 0\nsecond_opinion = 1.0"))
    assert plain["second_opinions"]["high"] == 0
    assert compared["second_opinions"] == compared["rollouts"] == plain["rollouts"]


def test_drawn_starts_are_counted_by_the_file(started: Processes) -> None:
    found = plan(started, campaign(started))
    (problem,) = found["problems"]
    assert problem["tests"] == {"middle": 40, "low": 40, "high": 40}
    assert found["pilot"]["rollouts"] == 10


@pytest.mark.journey
def test_the_table_is_for_people(started: Processes) -> None:
    ended = started.run("perfbound", "plan", FOLDER / "test-function.toml", "--workers", "3")
    assert ended.code == 0
    assert ended.out.startswith("test-function with 3 workers\n")
    assert "2 workers of 3 will wait" in ended.out.replace("\n", " ")


def test_nothing_is_left_behind(started: Processes) -> None:
    path, temporary = campaign(started), started.folder / "temporary"
    temporary.mkdir()
    before = {each for each in started.folder.iterdir() if each.suffix in {".toml", ".py"}}
    process = started.start("perfbound", "plan", path, TMPDIR=str(temporary))
    assert process.wait().code == 0
    assert not list(temporary.iterdir())
    assert {each for each in started.folder.iterdir() if each.suffix in {".toml", ".py"}} == before
    assert not (started.folder / "runs").exists()


@pytest.mark.parametrize(
    ("system", "keys", "fault"),
    [
        ("good", "sede = 1", "sede: unknown key; did you mean 'seed'?"),
        ("nobody", "", "nobody"),
        ("failing", "", "division by zero"),
    ],
)
def test_a_fault_is_one_line(started: Processes, system: str, keys: str, fault: str) -> None:
    path = campaign(started, system, keys)
    ended = started.run("perfbound", "plan", path)
    assert (ended.code, ended.out) == (1, "")
    assert ended.fault.startswith(f"perfbound: {path}")
    assert fault in ended.fault


def test_a_signal_ends_the_pilot(started: Processes) -> None:
    process = started.start("perfbound", "plan", campaign(started, "slow"))
    wait_for(lambda: process.children_with("pilot"))
    children = process.children()
    process.popen.send_signal(signal.SIGTERM)
    ended = process.wait()
    assert ended.code == 128 + signal.SIGTERM
    assert ended.last_line == "perfbound: stopped; the pilot was ended, nothing was written"
    assert not [each for each in children if each.is_running() and each.status() != psutil.STATUS_ZOMBIE]


def test_a_batch_is_proposed_to_a_vectorised_system_and_is_in_the_forecast(started: Processes) -> None:
    (started.folder / "systems.py").write_text(
        "import perfbound as pb\n\n"
        '@pb.system(parameters={"x": pb.Parameter(0, 5, unit="m")}, columns={"value": "m"}, vectorised=True)\n'
        "def good(x, *, seeds):\n    return x + pb.uniform(seeds, 1)[:, 0]\n"
    )
    path = campaign(started, keys="recheck = 0")
    path.write_text(path.read_text().replace("max_tests = 40", "max_tests = 30_000"))
    alone = plan(started, path, "--workers", "2")
    assert any("`batch = 1024`" in line for line in alone["notes"])
    path.write_text(f"batch = 1024\n{path.read_text()}")
    together = plan(started, path, "--workers", "2")
    assert together["notes"] == []
    assert together["problems"][0]["batch"] == 1024
    assert together["seconds"]["middle"] < alone["seconds"]["middle"] / 5
    assert together["pilot"]["added"] < together["pilot"]["seconds"]
