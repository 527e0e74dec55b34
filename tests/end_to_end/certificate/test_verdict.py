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
