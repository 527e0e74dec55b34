"""The verdict as a user meets it: the end of a run, `show`, `status`, the report and a command of the user."""

import json
import shlex
import sys
from pathlib import Path

import pytest

from tests.end_to_end.processes import Ended, Processes, processes

SYSTEM = """import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"value": "m"})
def slope(x):
    return 1.0 - 1.5 * x
"""
CAMPAIGN = """specification = "value >= LIMIT"
rkhs_norm = 3
noise_scale = 0
alpha = 0.05
spot_check = 20
system.python = "slope.py:slope"
space.x = [0, 1]
"""
SCREEN = 30
"""Lines of a small terminal."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("verdict")
    (found / "slope.py").write_text(SYSTEM)
    for name, limit in (("good", "-1"), ("bad", "-0.25")):
        (found / f"{name}.toml").write_text(CAMPAIGN.replace("LIMIT", limit))
    (found / "gate.py").write_text("import sys, json; print(json.load(sys.stdin)['verdict']); sys.exit(7)")
    return found


@pytest.fixture(scope="module")
def good(folder: Path) -> Ended:
    gate = shlex.join([sys.executable, str(folder / "gate.py")])
    with processes(folder / "logs") as found:
        return found.run("perfbound", "run", folder / "good.toml", "--out", folder / "good", "--on-finish", gate)


@pytest.mark.journey
def test_the_end_of_a_run_fits_one_screen(good: Ended) -> None:
    assert good.code == 0, good.err
    lines = good.out.splitlines()
    assert lines[0] == "VERDICT  SHOWN, rests on the length scale"
    assert lines[1].strip().startswith("Margin at least 0.")
    assert len(lines) <= SCREEN
    assert sum(line.startswith("CLAIM  ") for line in lines) == 1


def test_a_command_gets_the_verdict_and_its_failure_changes_nothing(good: Ended) -> None:
    assert "\nSHOWN\n" in good.err
    assert "exit code 7; the certificate stands" in good.err


@pytest.mark.journey
def test_show_prints_everything_and_the_assumptions_on_request(started: Processes, folder: Path, good: Ended) -> None:
    assert good.code == 0
    short = started.run("perfbound", "show", folder / "good")
    full = started.run("perfbound", "show", folder / "good", "--assumptions")
    assert short.code == full.code == 0
    assert short.out.splitlines()[0] == "VERDICT  SHOWN, rests on the length scale"
    for part in ("After the campaign", "Problems", "Output files"):
        assert part in short.out
    assert "simulator_is_the_system" in full.out
    assert "simulator_is_the_system" not in short.out
    assert f"perfbound show {folder / 'good'} --assumptions" in short.out


def test_a_violated_requirement_is_the_first_thing_to_read(started: Processes, folder: Path) -> None:
    ended = started.run("perfbound", "run", folder / "bad.toml", "--out", folder / "bad")
    assert ended.code == 0, ended.err
    lines = ended.out.splitlines()
    assert lines[0] == "VERDICT  VIOLATED"
    assert lines[1].strip().startswith("At x = 1 the robustness is -0.2500 m, and nothing")
    (count,) = (line for line in lines if "rollouts violate the specification, at " in line)
    assert int(count.split()[0]) > 0
    again = started.run("perfbound", "status", folder / "bad")
    assert "VERDICT  VIOLATED" in again.out
    report = json.loads(started.run("perfbound", "report", folder / "bad", "--json").out)
    assert report["verdict"]["word"] == "VIOLATED"
    assert report["verdict"]["command"].startswith(f"perfbound replay {folder / 'bad'} robustness.")


def test_an_unfinished_campaign_has_no_verdict(started: Processes, folder: Path) -> None:
    first = started.start("perfbound", "orchestrate", folder / "good.toml", "--out", folder / "open")
    while not (folder / "open" / "campaign.db").exists():
        assert first.running
    shown = started.run("perfbound", "show", folder / "open")
    first.popen.terminate()
    first.wait()
    assert shown.code == 1
    assert "no certificate yet" in shown.fault


SHIFTING = """import numpy as np
import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"value": "m", "gear": "discrete"}, step=0.5)
def shifting(x, *, horizon):
    t = np.arange(round(horizon / 0.5) + 1) * 0.5
    return np.column_stack([1.0 - 0.5 * x + 0.1 * t, np.where(t < 1, 1, 2)])
"""
OF_WINDOWS = """specification = "always eventually[0,9] value >= 0.2 and always (rise(gear == 2) implies gear != 1)"
horizon = 2
max_tests = 10
rkhs_norm = 3
noise_scale = 0
alpha = 0.05
spot_check = 20
system.python = "shifting.py:shifting"
space.x = [0, 1]
"""


def test_windows_that_end_with_the_rollout_are_named(tmp_path: Path) -> None:
    (tmp_path / "shifting.py").write_text(SHIFTING)
    (tmp_path / "refused.toml").write_text(OF_WINDOWS)
    (tmp_path / "cut.toml").write_text('beyond = "truncate"\n' + OF_WINDOWS)
    with processes(tmp_path / "logs") as found:
        refused = found.run("perfbound", "run", tmp_path / "refused.toml", "--out", tmp_path / "refused")
        assert refused.code != 0
        assert "reaches to 11 s, but the trajectory ends at 2 s" in refused.err
        ended = found.run("perfbound", "run", tmp_path / "cut.toml", "--out", tmp_path / "run")
        assert ended.code == 0, ended.err
        (claim,) = (line for line in ended.out.splitlines() if line.startswith("CLAIM"))
        assert "windows truncated at the end of a rollout" in ended.out.replace("\n", " "), claim
        verified = found.run("perfbound", "verify", tmp_path / "run")
        assert verified.code == 0, verified.err
        shown = found.run("perfbound", "show", tmp_path / "run", "--assumptions")
        assert "what follows the end" in shown.out
