"""A search with a model of each part of the specification: the same bytes for any number of workers and after kills.

Most starts are of an arm of the search, and none violates.
"""

import json
import signal
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, attempts, catch, of_run, processes, query, recorded, wait_for

TESTS, WINDOW, RECHECK = 48, 2, 3
SYSTEM = '''"""A car follows another one that brakes: its radar sees 10 m, and a rough road shakes its brake."""

import time

import numpy as np

import perfbound as pb


@pb.system(
    parameters={
        "gap": pb.Parameter(5, 100, unit="m"),
        "speed": pb.Parameter(5, 35, unit="m/s"),
        "road": pb.Parameter(-1, 1, unit="1", signal=True),
    },
    columns={"distance": "m", "speed": "m/s", "force": "kN"},
)
def cars(gap, speed, road, *, seed, horizon):
    time.sleep(0.02)
    t = np.linspace(0.0, horizon, 41)
    ahead = np.maximum(speed - 6 * t, 0)
    follower = np.maximum(speed - 10 * np.maximum(t - 0.6, 0), 0)
    seen = np.clip(gap + np.cumsum(ahead - follower) * t[1], 4, 10)
    shaken = np.maximum(np.cumsum(road(t)) * t[1] - 1.8, 0)
    force = 1 + shaken * np.random.default_rng(seed).uniform(0.8, 1.2)
    return {"t": t, "distance": seen, "speed": follower, "force": force}
'''
# Two rollouts of a test are often equally bad, by the distance, and have another force: then the order in which they
# arrive must not decide which force the search learns.
CAMPAIGN = f"""seed = 6
horizon = 4.0
specification = "always (distance >= 2 and force <= 8) and (eventually speed <= 10 or always distance >= 3)"
falsify = {{}}
max_tests = {TESTS}
window = {WINDOW}
replicates = 2
recheck = {RECHECK}
spot_check = 0
system.python = "cars.py:cars"

[space]
gap = [5, 100]
speed = [5, 35]
road = {{ signal = "constant", knots = 3, low = -1, high = 1 }}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with system and campaign, and the run of one worker without trouble in `calm`."""
    found = tmp_path_factory.mktemp("search")
    (found / "cars.py").write_text(SYSTEM)
    (found / "c.toml").write_text(CAMPAIGN)
    with processes(found / "logs") as started:
        ended = started.run("perfbound", "run", found / "c.toml", "--workers", "1", "--out", found / "calm")
    assert ended.code == 0, ended.err
    return found


def starts(directory: Path) -> list[tuple[object, ...]]:
    return query(directory, "SELECT test, x FROM tests WHERE problem = 'robustness' ORDER BY test")


def check(started: Processes, directory: Path, calm: Path) -> None:
    """Compare a run with the calm one, and verify it."""
    assert starts(directory) == starts(calm)
    for name in ("certificate.json", "manifest.sha256"):
        assert (directory / name).read_bytes() == (calm / name).read_bytes()
    check_replay(started, directory)


def check_replay(started: Processes, directory: Path) -> None:
    """Verify a run, which chooses each of its starts again."""
    verified = started.run("perfbound", "verify", directory, "--json")
    assert verified.code == 0, verified.out
    found = {each["check"]: each for each in json.loads(verified.out)["checks"]}
    assert found["proposals"]["status"] == "passed"
    # Each to the bit: it counts the starts that only another machine, which rounds differently, could have chosen.
    assert found["proposals"]["detail"] == f"{TESTS + RECHECK} tests"


@pytest.mark.parametrize("workers", ["2", "5"])
def test_a_killed_worker_changes_no_byte(started: Processes, folder: Path, tmp_path: Path, workers: str) -> None:
    directory = tmp_path / "run"
    process = started.start("perfbound", "run", folder / "c.toml", "--workers", workers, "--out", directory)
    rollout, worker = catch(directory, lambda: recorded(directory) >= TESTS)
    worker.kill()
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert len(attempts(directory, rollout)) == 2
    check(started, directory, folder / "calm")


def test_a_killed_orchestrator_changes_no_byte(started: Processes, folder: Path, tmp_path: Path) -> None:
    directory = tmp_path / "run"
    process = started.start("perfbound", "run", folder / "c.toml", "--workers", "2", "--out", directory)
    wait_for(lambda: recorded(directory) >= TESTS)
    process.popen.kill()
    assert process.wait().code == -signal.SIGKILL
    wait_for(lambda: not of_run(directory))
    assert recorded(directory) < 2 * TESTS, "the kill has to come in mid-run"
    resumed = started.run("perfbound", "resume", directory, "--workers", "1")
    assert resumed.code == 0, resumed.err
    check(started, directory, folder / "calm")


def test_every_kind_of_start_occurs(started: Processes, folder: Path) -> None:
    """By the table of the search, and by what it had observed before each test: all but those of the window."""
    observed = worst(folder / "calm")
    kinds = [kind(test, max(0, test + 1 - WINDOW)) for test in range(TESTS)]
    assert set(kinds) == {"drawn", "first", "corner", "middle", "by an arm"}
    assert {len(parts) for _, parts in observed} == {4}, "each side of every `and` and `or` is a part"
    tied = "GROUP BY test HAVING COUNT(DISTINCT robustness) = 1 AND COUNT(DISTINCT parts) = 2"
    assert query(folder / "calm", f"SELECT test FROM rollouts WHERE problem = 'robustness' {tied}")
    check_replay(started, folder / "calm")


def worst(directory: Path) -> list[tuple[float, Sequence[float]]]:
    """Return the robustness of each test, and that of its parts."""
    rows = query(directory, "SELECT test, robustness, parts FROM rollouts WHERE problem = 'robustness'")
    found: dict[int, tuple[float, Sequence[float]]] = {}
    for test, robustness, parts in rows:
        each = float(str(robustness)), json.loads(str(parts))
        found[int(str(test))] = min(each, found.get(int(str(test)), each))
    return [found[test] for test in sorted(found)]


def kind(test: int, observed: int) -> str:
    """Return the kind of start of a test, before which so many were observed."""
    if test % 4 == 3:
        return "drawn"
    if test == 1:
        return "corner"
    if not observed:
        return "first"
    return "middle" if test == 2 else "by an arm"
