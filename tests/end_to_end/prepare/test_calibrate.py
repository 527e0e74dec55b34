"""`perfbound calibrate` with a real system: from a draft without constants to a certificate, or to another method."""

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.schemas.file.problem_models import KrigingProblem, RigorousProblem
from perfbound.schemas.file.reader import load_campaign
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Processes, contents, processes, wait_for
from tests.end_to_end.product.test_wheel import ROOT

CARS = ROOT / "deploy" / "examples" / "cars" / "cars.py"
SYSTEMS = """import time

import numpy as np
import perfbound as pb

BOX = {"x": pb.Parameter(0, 5, unit="m"), "y": pb.Parameter(-1, 1)}

@pb.system(parameters=BOX, columns={"value": "m"})
def smooth(x, y):
    return 1.2 + np.sin(x) * np.cos(2 * y)

@pb.system(parameters=BOX, columns={"value": "m"})
def jumping(x, y):
    return 1.2 + np.sin(x) * np.cos(2 * y) - (0.8 if x + y > 4.9 else 0)

@pb.system(parameters=BOX, columns={"value": "m"})
def noisy(x, y, *, seed):
    return 1.2 + 0.1 * np.sin(x) * np.cos(2 * y) + 0.1 * np.random.default_rng(seed).standard_normal()

@pb.system(parameters=BOX, columns={"value": "m"})
def slow(x, y):
    time.sleep(0.2)
    return x

@pb.system(parameters=BOX, columns={"value": "m"})
def failing(x, y):
    return 1 / (x - x) if x > 4 else x
"""
DRAFT = 'specification = "value >= 0"\nspace.x = [0, 5]\nspace.y = [-1, 1]\nsystem.python = "systems.py:{}"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Processes]:
    (tmp_path / "systems.py").write_text(SYSTEMS)
    for name in ("smooth", "jumping", "noisy", "slow", "failing"):
        (tmp_path / f"{name}.toml").write_text(DRAFT.format(name))
    with processes(tmp_path) as started:
        yield started


def certified(folder: Processes, name: str) -> Certificate:
    ended = folder.run("perfbound", "run", f"{name}-calibrated.toml", "--out", f"runs-{name}")
    assert ended.code == 0, ended.err
    return Certificate.model_validate_json((folder.folder / f"runs-{name}" / "certificate.json").read_bytes())


@pytest.mark.journey
def test_a_smooth_function_gets_constants_that_are_not_refuted(folder: Processes) -> None:
    ended = folder.run("perfbound", "calibrate", "smooth.toml")
    assert (ended.code, ended.err) == (0, ""), ended.err
    for key in ("prior_mean", "kernel", "rkhs_norm", "noise_scale", "alpha", "max_tests"):
        assert f"\n{key} " in ended.out
    answer = ended.out.splitlines()[0]
    assert re.match(r"Can be shown: about [\d,]+ rollouts \(.* on 2 workers\) for robustness >= 0 m; ", answer), answer
    assert answer.endswith("Fitted on 400 pilot rollouts; no proof.")
    assert "rollouts per second on 2 workers" in ended.out
    assert "forecast: alpha = " in ended.out
    assert "perfbound run smooth-calibrated.toml" in ended.out
    evidence = folder.folder / "smooth-calibration"
    assert (evidence / "calibration-robustness.png").read_bytes().startswith(b"\x89PNG")
    numbers = json.loads((evidence / "calibration.json").read_text())
    assert numbers["trustworthy"]
    assert numbers["problems"][0]["rollouts"] <= 400
    claim = certified(folder, "smooth").predicate.claims[0]
    assert claim.refuted == ()
    assert 0.0 < 0.2 - claim.bound < 0.2, "the truth is .2"


def test_the_tolerance_is_small_enough_for_what_is_required(folder: Processes) -> None:
    """The least value is .2, which leaves a twentieth of the range no room."""
    alphas = dict[str, float]()
    for required in ("0.0", "0.17", "0.3"):
        name = f"smooth-{required[-2:].strip('.')}"
        (folder.folder / f"{name}.toml").write_text(f"required_margin = {required}\n{DRAFT.format('smooth')}")
        ended = folder.run("perfbound", "calibrate", f"{name}.toml")
        assert ended.code == 0, ended.err
        (problem,) = load_campaign(folder.folder / f"{name}-calibrated.toml").problems
        alphas[required] = problem.alpha or 0.0
        assert ended.out.startswith(
            "Cannot be shown with any budget: one of " if required == "0.3" else "Can be shown: "
        )
        if required == "0.17":
            assert "leaves to what is required" in " ".join(ended.out.split())
            assert folder.run("perfbound", "run", f"{name}-calibrated.toml", "--out", "run").out.startswith(
                "VERDICT  SHOWN"
            )
    assert ", below the required 0.3 m.\n" in ended.out, "the worst start itself is below .3"
    assert 0.0 < alphas["0.17"] < alphas["0.0"]


def test_a_jump_gets_a_campaign_without_a_kernel(folder: Processes) -> None:
    ended = folder.run("perfbound", "calibrate", "jumping.toml", "--rollouts", "200", "--out", "evidence")
    assert (ended.code, ended.err) == (0, ""), ended.err
    assert "robustness: no kernel is trustworthy.\n  The objective jumps: " in ended.out
    assert (folder.folder / "evidence" / "calibration-robustness.png").exists()
    claim = certified(folder, "jumping").predicate.claims[0]
    assert claim.quantity == "failure_probability"


def test_noisy_rollouts_get_clip_noise_and_replicates(folder: Processes) -> None:
    (folder.folder / "cars.py").write_text(CARS.read_text())
    draft = folder.folder / "cars.toml"
    draft.write_text(
        'horizon = 8.0\nspecification = "always (distance >= 2)"\nsystem.python = "cars.py:cars"\n'
        "space.gap = [20, 50]\nspace.speed = [10, 30]\n"
    )
    assert folder.run("perfbound", "calibrate", draft).code == 0
    config = load_campaign(folder.folder / "cars-calibrated.toml")
    problem = config.problems[0]
    assert isinstance(problem, RigorousProblem)
    # The delay is uniform over .5 s times .4, at most 30 m/s: a standard deviation of 1.7 m.
    assert 1.0 < float(problem.noise_scale) < 3.5
    assert config.clip is not None
    assert config.clip[0] < 0
    assert config.replicates >= 2


def test_a_planned_method_gets_a_budget_with_its_forecast_and_a_campaign(folder: Processes) -> None:
    draft = folder.folder / "noisy.toml"
    draft.write_text(f'method = "kriging"\nresolution = 9\n{draft.read_text()}')
    ended = folder.run("perfbound", "calibrate", "noisy.toml", "--rollouts", "200")
    assert (ended.code, ended.err) == (0, ""), ended.err
    assert "robustness: forecast of the bound, if every assumption holds; without any rollout it is " in ended.out
    assert ended.out.count("<- proposed") == 1
    (numbers,) = json.loads((folder.folder / "noisy-calibration" / "calibration.json").read_text())["forecasts"]
    assert len(numbers["budgets"]) == 5
    written = folder.folder / "noisy-calibrated.toml"
    problem = load_campaign(written).problems[0]
    assert isinstance(problem, KrigingProblem)
    # A small plan of the same file, whose bound is valid as well.
    lines = written.read_text().splitlines()
    kept = [each for each in lines if not each.startswith(("max_tests", "replicates"))]
    written.write_text("\n".join(["max_tests = 50", "replicates = 4", "spot_check = 20", "recheck = 2", *kept]) + "\n")
    claim = certified(folder, "noisy").predicate.claims[0]
    assert claim.refuted == ()
    assert claim.bound < 1.1, "the truth is about 1.1"
    assert claim.bound > numbers["without_rollouts"]


def test_a_list_of_starts_needs_another_method(folder: Processes) -> None:
    draft = folder.folder / "list.toml"
    draft.write_text(
        'specification = "value >= 0"\nmethod = "kriging"\nsystem.python = "systems.py:noisy"\n'
        "space.scenarios = [[1, 0], [2, 0]]\n"
    )
    for command in ("run", "calibrate"):
        ended = folder.run("perfbound", command, "list.toml")
        assert ended.last_line == (
            "perfbound: list.toml: method: 'kriging' needs a box under [space]: low and high per parameter; for a list "
            "of scenarios under [space] choose 'rigorous' or 'scenario'"
        )


def test_existing_files_stay_as_they_are_and_cost_no_rollout(folder: Processes) -> None:
    written = folder.folder / "slow-calibrated.toml"
    written.write_text("mine\n")
    ended = folder.run("perfbound", "calibrate", "slow.toml")
    assert ended.code == 1
    assert ended.fault == "perfbound: slow-calibrated.toml: exists already and stays as it is; move or rename it"
    assert written.read_text() == "mine\n"
    written.unlink()
    evidence = folder.folder / "evidence"
    evidence.mkdir()
    (evidence / "calibration.json").write_text("{}")
    ended = folder.run("perfbound", "calibrate", "slow.toml", "--out", "evidence")
    assert ended.fault.endswith("evidence/calibration.json: exists already and stays as it is; choose another --out")


def test_a_rollout_that_fails_is_named(folder: Processes) -> None:
    before = contents(folder.folder)
    ended = folder.run("perfbound", "calibrate", "failing.toml")
    assert ended.code == 1
    assert ended.last_line.startswith("perfbound: failing.toml: x = ")
    assert "ZeroDivisionError" in ended.last_line
    made = {name for name in contents(folder.folder).keys() - before.keys() if not name.startswith("__pycache__")}
    assert made <= {"log-0/out", "log-0/err"}


def test_ctrl_c_leaves_no_file_and_no_process(folder: Processes) -> None:
    process = folder.start("perfbound", "calibrate", "slow.toml")
    wait_for(lambda: process.children_with("pilot"))
    started = process.children()
    process.signal_group(signal.SIGINT)
    ended = process.wait()
    assert ended.code == 130
    assert ended.last_line == "perfbound: stopped; the calibration was ended, nothing was written"
    assert not any(each.is_running() for each in started)
    assert not (folder.folder / "slow-calibrated.toml").exists()
    assert not (folder.folder / "slow-calibration").exists()
