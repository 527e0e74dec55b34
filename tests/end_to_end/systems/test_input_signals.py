"""Inputs over time, to a function and to a program: from the campaign file to a certificate that verifies."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.certificate.verify.checks import ABSENT
from perfbound.schemas.trajectory.trajectory import read_mcap
from tests.end_to_end.processes import Processes, recorded, wait_for
from tests.end_to_end.report.test_report import page_data

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "follow"
FUNCTION = '''"""A mass that an input moves, from rest."""

import numpy as np

import perfbound as pb


@pb.system(
    parameters={"push": pb.Parameter(-1, 1, unit="N", signal=True), "mass": pb.Parameter(1, 3, unit="kg")},
    columns={"speed": "m/s", "applied": "N"},
)
def mass(push, mass, *, horizon=2.0):
    t = np.linspace(0.0, horizon, 201)
    force = push(t)
    return {"t": t, "speed": np.cumsum(force) * (t[1] - t[0]) / mass, "applied": force}
'''
PROGRAM = """import json, sys
for line in sys.stdin:
    asked = json.loads(line)
    push, mass, step = asked["start"]["push"], asked["start"]["mass"], 0.01
    speed, rows = 0.0, []
    for k in range(round(asked["horizon"] / step) + 1):
        t = k * step
        force = [u for u, at in zip(push["knots"], push["times"]) if at <= t + 1e-9][-1]
        speed += force * step / mass
        rows.append(f"{t},{speed},{force}")
    open(asked["path"], "w").write("".join(row + "\\n" for row in rows))
    print('{"done": true}', flush=True)
"""
CAMPAIGN = """horizon = 2.0
specification = "always (speed <= 2)"
max_tests = 12
spot_check = 6
recheck = 3
resolution = 5
alpha = 0.05
rkhs_norm = 5.0
noise_scale = 0
kernel = { length_scale = { push = 1.0, mass = 2.0 } }

[space]
push = { signal = "KIND", knots = 2, low = -1, high = 1, unit = "N" }
mass = { low = 1, high = 3, unit = "kg" }

[system]
"""
SYSTEMS = {
    "function": ("pchip", 'python = "mass.py:mass"\n', {"mass.py": FUNCTION}, "{folder}/mass.py:mass"),
    "program": (
        "constant",
        f'program = [{json.dumps(sys.executable)}, "mass_program.py"]\n'
        'columns = { t = "s", speed = "m/s", applied = "N" }\n',
        {"mass_program.py": PROGRAM},
        "{folder}/c.toml",
    ),
}


def least_distances(knots: Any, gap: Any, speed: Any) -> Any:
    """Return the least distance of `deploy/examples/follow` from starts (n,), all of them at once."""
    t, distance, own, ahead = np.arange(200) * 0.05, gap.copy(), speed.copy(), speed.copy()
    least = gap.copy()
    for at in t:
        demand = [np.interp(at, np.linspace(0.0, 10.0, 4), row) for row in np.eye(4)] @ knots.T
        control = 0.25 * (distance - 3.0 - 1.4 * own) + 0.8 * (ahead - own)
        own = np.maximum(own + 0.05 * np.clip(control, -7.0, 2.0), 0.0)
        ahead = np.maximum(ahead + 0.05 * demand, 0.0)
        distance = distance + 0.05 * (ahead - own)
        least = np.minimum(least, distance)
    return least


def test_a_claim_over_six_parameters_is_confirmed_by_random_starts(started: Processes, tmp_path: Path) -> None:
    for file in EXAMPLE.iterdir():
        shutil.copy(file, tmp_path)
    ended = started.run("perfbound", "run", tmp_path / "follow.toml", "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    assert "robustness: the claim is about the worst of 4,096 listed starts, spread over the ranges of 6" in ended.err
    assert "CLAIM  robustness at the worst of the 4,096 listed starts >= 1.1133 m" in ended.out
    # Fresh starts of the whole region say how much of it the list speaks for.
    assert "Bound of robustness: not refuted, 0 of 299 fresh starts are beyond it" in ended.out
    verify = ("perfbound", "verify", tmp_path / "run", "--resimulate", "3", "--system")
    verified = started.run(*verify, f"{tmp_path / 'follow.py'}:follow")
    assert verified.code == 0, verified.out

    random = np.random.default_rng(1)
    knots, gap, speed = random.uniform(-4, 2, (150_000, 4)), *random.uniform([20, 10], [70, 30], (150_000, 2)).T
    inside = gap >= 1.4 * speed
    assert inside.sum() > 100_000
    assert least_distances(knots[inside], gap[inside], speed[inside]).min() - 2.0 >= 1.1133


@pytest.mark.parametrize("name", SYSTEMS)
def test_killed_and_resumed_it_verifies(started: Processes, tmp_path: Path, name: str) -> None:
    kind, system, files, reference = SYSTEMS[name]
    for file, text in files.items():
        (tmp_path / file).write_text(text)
    system = system.replace('t = "s", ', "")
    (tmp_path / "c.toml").write_text(CAMPAIGN.replace("KIND", kind) + system)
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    ended = started.run("perfbound", "run", tmp_path / "c.toml", "--out", calm)
    assert ended.code == 0, ended.err

    first = started.start("perfbound", "run", tmp_path / "c.toml", "--out", killed, "--workers", "1")
    wait_for(lambda: recorded(killed) >= 2)
    first.popen.kill()
    first.wait()
    resumed = started.run("perfbound", "resume", killed)
    assert resumed.code == 0, resumed.err
    assert (calm / "certificate.json").read_bytes() == (killed / "certificate.json").read_bytes()

    verify = ("perfbound", "verify", killed, "--resimulate", "3", "--json", "--system")
    verified = started.run(*verify, reference.format(folder=tmp_path))
    assert verified.code == 0, verified.out
    found = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) <= {"signature"}

    # The file of a rollout says which of its numbers are knots, and the system got what they say.
    rollout = read_mcap(next((calm / "trajectories").rglob("*.mcap")).read_bytes())
    assert rollout.request["signals"] == [{"name": "push", "kind": kind, "knots": 2}]
    first_knot, last_knot, _ = rollout.request["x"]
    applied = rollout.trajectory.column("applied")
    assert (applied[0], applied[-1]) == pytest.approx((first_knot, last_knot), abs=1e-12)

    data = page_data(calm)
    assert [each["name"] for each in data["axes"]] == ["push_0", "push_1", "mass"]
    drawn = [scene["inputs"] for scene in data["scenes"] if scene["inputs"]]
    assert drawn
    assert all([each["name"] for each in inputs] == ["push"] for inputs in drawn)
    exported = started.run("perfbound", "export", calm, "tests", "--out", "-")
    assert "push_0" in exported.out.splitlines()[0]


FORMS = f"""horizon = 8.0
specification = "always (abs(speed - reference) <= 4)"
method = "sample"
max_tests = 20
batch = 4

[space]
push = {{ signal = "constant", times = [0, 1, 3, 7.25], low = -1, high = 1, unit = "N" }}
gust = {{ signal = "sine", amplitude = [0, 2], frequency = [0.1, 2], unit = "N" }}
reference = {{ profile = "reference.csv", unit = "m/s" }}
mass = {{ low = 1, high = 3, unit = "kg" }}

[system]
program = [{json.dumps(sys.executable)}, "forms.py"]
columns = {{ speed = "m/s" }}
"""
FORMS_PROGRAM = """import json, math, sys
for line in sys.stdin:
    asked = json.loads(line)
    push, gust, mass = (asked["start"][name] for name in ("push", "gust", "mass"))
    step = 0.01
    assert asked["start"]["reference"] == {"signal": "linear", "knots": [0.0, 1.5, 0.5], "times": [0.0, 2.0, 6.0]}
    speed, rows = 0.0, []
    for k in range(round(asked["horizon"] / step) + 1):
        t = k * step
        force = [u for u, at in zip(push["knots"], push["times"]) if at <= t + 1e-9][-1]
        force += gust["offset"] + gust["amplitude"] * math.sin(2 * math.pi * gust["frequency"] * t + gust["phase"])
        speed += force * step / mass
        rows.append(f"{t},{speed}")
    open(asked["path"], "w").write("".join(row + "\\n" for row in rows))
    print('{"done": true}', flush=True)
"""


def test_a_formula_names_a_recorded_profile_beside_times_and_a_sine(started: Processes, tmp_path: Path) -> None:
    (tmp_path / "forms.py").write_text(FORMS_PROGRAM)
    (tmp_path / "c.toml").write_text(FORMS)
    (tmp_path / "reference.csv").write_text("t,value\n0,0\n2,1.5\n6,0.5\n")
    ended = started.run("perfbound", "run", tmp_path / "c.toml", "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    verify = ("perfbound", "verify", tmp_path / "run", "--resimulate", "3", "--json", "--system", tmp_path / "c.toml")
    verified = started.run(*verify)
    assert verified.code == 0, verified.out
    found = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) <= {"signature"}

    header = started.run("perfbound", "export", tmp_path / "run", "tests", "--out", "-").out.splitlines()[0]
    names = [*(f"push_{k} (N)" for k in range(4)), "gust_amplitude (N)", "gust_frequency (Hz)", "mass (kg)"]
    assert header.split(",")[3 : 3 + len(names)] == names
    data = page_data(tmp_path / "run")
    scene = next(each for each in data["scenes"] if each["inputs"])
    assert [each["name"] for each in scene["inputs"]] == ["push", "gust", "reference"]
    # The reference is a column of the evidence, which the program did not write.
    curve = next(each for each in scene["traces"] if each["column"] == "reference")
    assert curve["unit"] == "m/s"
    assert curve["values"] == pytest.approx(np.interp(curve["t"], [0, 2, 6], [0, 1.5, 0.5]).tolist(), abs=1e-12)


LONG = """horizon = 2.0
specification = "always (abs(speed - push) <= 0.5)"
method = "sample"
max_tests = 12
recheck = 2

[system]
python = "mass.py:mass"
after_end = "hold"

[space]
push = { signal = "linear", knots = 1000, rate = 5, low = -1, high = 1, unit = "N" }
mass = [1, 3]
"""


def test_a_thousand_knots_with_a_rate_are_a_curve_in_the_report(started: Processes, tmp_path: Path) -> None:
    (tmp_path / "mass.py").write_text(FUNCTION)
    (tmp_path / "c.toml").write_text(LONG)
    ended = started.run("perfbound", "run", tmp_path / "c.toml", "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    assert "share_900" not in ended.out
    rollout = read_mcap(next((tmp_path / "run" / "trajectories").rglob("*.mcap")).read_bytes())
    assert rollout.trajectory.columns == ("t", "speed", "applied", "push", "ended")
    push = rollout.trajectory.column("push")
    assert push.tolist() == rollout.trajectory.column("applied").tolist()
    assert np.abs(np.diff(push)).max() <= 5 * 0.01 * (1 + 1e-9)
    data = page_data(tmp_path / "run")
    assert [each["signal"] for each in data["axes"]] == ["push"] * 1000 + [""]
    assert len(json.dumps(data)) < 2_000_000
    verified = started.run(
        "perfbound", "verify", tmp_path / "run", "--resimulate", "1", "--system", tmp_path / "c.toml"
    )
    assert verified.code == 0, verified.out
