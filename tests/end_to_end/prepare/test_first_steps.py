"""The first steps of a user: `init` to a certificate, `simulate` to a picture, `new-system` to an installed package."""

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.prepare.init.new_package import write_package
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.trajectory.trajectory import decode
from tests.end_to_end.processes import Processes, contents, processes
from tests.end_to_end.product.test_wheel import ROOT, backend, call, environment, site_packages

CARS = ROOT / "deploy" / "examples" / "cars" / "cars.py"
CHECKS = "spot_check = 6\nspot_check_followups = 4\nrecheck = 3\n"

BAD = """import numpy as np
import perfbound as pb

R = {"x": pb.Parameter(0, 1)}

@pb.system(parameters=R, columns={"a": "m"}, step=0.1)
def short(x, *, seed, horizon=5.0):
    print("it lives at", x)
    return np.zeros(20)

@pb.system(parameters=R, columns={"a": "m"}, step=0.1)
def fails(x, *, horizon=5.0):
    print("before")
    return 1 / (x - x)

@pb.system(parameters=R, columns={"a": "m"}, step=0.1)
def fixed(x):
    return np.arange(31.0) * x

@pb.system(parameters=R, columns={"a": "m"})
def crash(x):
    import os
    print("last words", flush=True)
    os.abort()

@pb.system(parameters=R, columns={"a": "m"})
def huge(x):
    return 1e308 * (x - 0.5)

@pb.system(parameters={"x": pb.Parameter(1, 1)}, columns={"a": "m"})
def point(x):
    return x

@pb.system(parameters={name: pb.Parameter(0, 1) for name in "abcd"}, columns={"y": "m"}, step=0.1)
def wide(a, b, c, d, *, horizon=1.0):
    return np.full(round(horizon / 0.1) + 1, 1.5 - a * b - 0.5 * c * d)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    found = tmp_path_factory.mktemp("first")
    (found / "systems").mkdir()
    (found / "systems" / "cars.py").write_text(CARS.read_text())
    (found / "systems" / "bad.py").write_text(BAD)
    with processes(found) as started:
        yield started


def shortened(file: Path, tests: int) -> None:
    """Give a campaign file few tests and short checks."""
    text, count = re.subn(r"^max_tests = \d+$", f"max_tests = {tests}", file.read_text(), flags=re.MULTILINE)
    text = re.sub(r"^(spot_check|spot_check_followups|recheck) = \d+\n", "", text, flags=re.MULTILINE)
    assert count == 1
    file.write_text(CHECKS + text)


def certified(started: Processes, file: Path, tests: int = 4) -> Certificate:
    """Run a campaign file with few tests, and return its certificate."""
    shortened(file, tests)
    out = file.with_suffix("")
    ended = started.run("perfbound", "run", file, "--out", out)
    assert ended.code == 0, ended.err
    return Certificate.model_validate_json((out / "certificate.json").read_bytes())


# init


@pytest.mark.parametrize(
    ("system", "arguments", "quantity"),
    [
        ("systems/cars.py:cars", (), "expected_robustness"),
        ("systems/bad.py:fixed", (), "robustness"),
        ("systems/bad.py:wide", ("--question", "worst"), "robustness"),
        ("test-function", (), "expected_robustness"),
        ("segway", ("--specification", "always (abs(phi) <= 0.95)"), "expected_robustness"),
        ("segway", ("--question", "transfer", "--specification", "always (abs(phi) <= 0.95)"), "rho_star"),
    ],
    ids=["cars", "fixed", "wide", "test-function", "segway", "segway-transfer"],
)
def test_the_written_file_runs_to_a_certificate(
    folder: Processes, tmp_path: Path, system: str, arguments: tuple[str, ...], quantity: str
) -> None:
    file = tmp_path / "c.toml"
    written = folder.run("perfbound", "init", system, *arguments, "--out", file)
    assert (written.code, written.err) == (0, ""), written.err
    # Its formula has one value at every start, from which no kernel follows.
    whence = "guessed, because" if "fixed" in system else "proposed from "
    assert f"{file}: the constants are {whence}" in written.out
    claims = certified(folder, file).predicate.claims
    assert claims[0].quantity == quantity


def test_above_three_parameters_the_usual_question_is_about_all_of_them(folder: Processes, tmp_path: Path) -> None:
    """And what is claimed, and about which starts, is said first."""
    file = tmp_path / "c.toml"
    usual = folder.run("perfbound", "init", "systems/bad.py:wide", "--out", file)
    assert usual.code == 0, usual
    assert "wide: 4 parameters, question `how-often`" in usual.out.splitlines()[0]
    assert "about starts that are drawn from the ranges" in usual.out.splitlines()[0]
    ended = folder.run("perfbound", "run", file, "--out", tmp_path / "run")
    assert ended.code == 0, ended
    assert "every start" not in ended.out
    listed = folder.run("perfbound", "init", "systems/bad.py:wide", "--question", "worst", "--out", tmp_path / "w.toml")
    assert "about the worst of 4,096 listed starts alone" in listed.out.splitlines()[0]
    shortened(tmp_path / "w.toml", 4)
    ended = folder.run("perfbound", "run", tmp_path / "w.toml", "--out", tmp_path / "listed")
    assert "from each of the 4,096 listed starts" in " ".join(ended.out.split())
    assert "every start" not in ended.out


def test_the_proposed_constants_are_not_refuted_and_prove_something(folder: Processes, tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    wish = ("--specification", "always[0,12] (distance >= 2)", "--horizon", "12", "--out", file)
    assert folder.run("perfbound", "init", "systems/cars.py:cars", *wish).code == 0
    assert "\nhorizon = 12.0\n" in file.read_text()
    claim = certified(folder, file, tests=30).predicate.claims[0]
    assert claim.refuted == ()
    assert claim.by_clip is not None
    assert claim.bound > claim.by_clip


def test_the_file_names_its_system_from_where_it_is(folder: Processes, tmp_path: Path) -> None:
    place = folder.folder / "elsewhere"
    place.mkdir()
    written = folder.run("perfbound", "init", "systems/bad.py:fixed", "--out", place / "c.toml")
    assert written.code == 0, written.err
    config = parse_campaign((place / "c.toml").read_bytes(), "c.toml")
    assert config.system.python == "../systems/bad.py:fixed"
    assert config.horizon == 3.0, "the duration of every rollout"
    assert config.clip is None, "nothing is random"


def test_a_file_that_exists_stays_as_it_is(folder: Processes, tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("mine")
    refused = folder.run("perfbound", "init", "test-function", "--out", file)
    assert (refused.code, refused.out) == (1, "")
    assert f"{file}: exists already and stays as it is; choose another --out" in refused.fault
    assert file.read_text() == "mine"


@pytest.mark.parametrize(
    ("system", "arguments", "words"),
    [
        ("segway", ("--question", "often"), "choose one of worst (How bad is the worst start?); fails (Is there a"),
        ("systems/cars.py:cars", ("--question", "transfer"), "cars has no variant true; give it two variants"),
        ("systems/bad.py:wide", ("--question", "safe"), "--question safe: wide has 4 parameters, and a map of safe"),
        ("segway", ("--specification", "always (pitch <= 1)"), "--specification: "),
        ("segway", ("--specification", "always[0,20] (phi <= 1)"), "reaches to 20 s, but the trajectory ends at 15 s"),
        ("systems/bad.py:point", (), "point: the range of x is empty; give it a low below its high"),
        ("segway", ("--horizon", "nan"), "--horizon nan: segway takes 0 to 120 s"),
        ("segway", ("--horizon", "121"), "--horizon 121: segway takes 0 to 120 s"),
        ("segway", ("--out", "no/c.toml"), "no/c.toml: there is no such folder; make it, or choose another --out"),
        ("bikes", (), "SYSTEM: 'bikes' is not an installed system; allowed are segway, segway-mujoco, test-function"),
    ],
)
def test_a_wish_that_cannot_be_met_is_one_line_and_no_file(
    folder: Processes, tmp_path: Path, system: str, arguments: tuple[str, ...], words: str
) -> None:
    refused = folder.run("perfbound", "init", system, "--out", tmp_path / "c.toml", *arguments)
    assert refused.code == 1
    assert words in refused.fault
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        ("short", "x = 0, seed 0: a campaign would refuse this rollout: the last row, 19, is at t = 1.9 s"),
        ("fails", "x = 0, seed 0: ZeroDivisionError: float division by zero (bad.py, line 14)"),
        ("crash", "x = 0, seed 0: `workers pilot` crashed (signal 6) in "),
        ("huge", "x = 0, seed 0: its values are above 1e+100"),
    ],
)
def test_a_pilot_that_fails_writes_nothing_and_says_what_to_do(
    folder: Processes, tmp_path: Path, system: str, reason: str
) -> None:
    refused = folder.run("perfbound", "init", f"systems/bad.py:{system}", "--out", tmp_path / "c.toml")
    assert refused.code == 1
    assert refused.fault.startswith(f"perfbound: the pilot failed, and nothing is written: {reason}")
    assert refused.fault.endswith(f"for all faults: perfbound check-system systems/bad.py:{system}")
    assert "perfbound run" not in refused.out
    assert not list(tmp_path.iterdir())


def test_a_question_that_needs_longer_rollouts_is_refused(folder: Processes, tmp_path: Path) -> None:
    refused = folder.run("perfbound", "init", "test-function", "--question", "transfer", "--out", tmp_path / "c.toml")
    assert refused.code == 1
    assert "--question transfer: rollouts of test-function are one sample" in refused.fault
    assert not list(tmp_path.iterdir())


@pytest.mark.journey
def test_function_and_campaign_file_take_few_lines(folder: Processes, tmp_path: Path) -> None:
    code = """import numpy as np
import perfbound as pb
@pb.system(parameters={"gap": pb.Parameter(5, 60), "v": pb.Parameter(5, 35)}, columns={"distance": "m"}, step=0.05)
def cars(gap, v, *, horizon):
    t = np.arange(0, horizon + 0.02, 0.05)
    behind = np.maximum(v - 7 * np.maximum(t - 0.5, 0), 0)
    return gap + 0.05 * np.cumsum(np.maximum(v - 6 * t, 0) - behind)
"""
    campaign = """name = "cars"
seed = 1
horizon = 8.0
specification = "always (distance >= 2)"
system.python = "cars.py:cars"
space.gap = { low = 20, high = 50 }
space.v = { low = 10, high = 30 }
max_tests = 40
[[problems]]
name = "robustness"
method = "rigorous"
alpha = 1.0
prior_mean = -25
rkhs_norm = 60
noise_scale = 0.0
kernel = { length_scale = { gap = 20, v = 12 } }
"""
    assert (code + campaign).count("\n") <= 25
    (tmp_path / "cars.py").write_text(code)
    (tmp_path / "c.toml").write_text(campaign)
    (claim,) = certified(folder, tmp_path / "c.toml").predicate.claims
    assert claim.quantity == "robustness"


# simulate


def test_a_rollout_is_drawn_and_what_it_prints_is_shown(folder: Processes, tmp_path: Path) -> None:
    code = BAD.replace("np.zeros(20)", "np.zeros(51)")
    (tmp_path / "good.py").write_text(code)
    drawn = folder.run("perfbound", "simulate", f"{tmp_path}/good.py:short", "--x", "0.5", "--plot", tmp_path / "a.png")
    assert drawn.code == 0
    assert drawn.err == "it lives at 0.5\n"
    assert "horizon 5 s, because --horizon is not given\n" in drawn.out
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {"good.py", "a.png"}


def test_a_short_rollout_is_shown_and_refused(folder: Processes, tmp_path: Path) -> None:
    place = ("--plot", tmp_path / "a.png", "--out", tmp_path / "a.mcap")
    refused = folder.run("perfbound", "simulate", "systems/bad.py:short", "--x", "0.5", *place)
    assert refused.code == 1
    assert refused.last_line == (
        "perfbound: a campaign would refuse this rollout: the last row, 19, is at t = 1.9 s, and the horizon is 5 s, "
        "before which it may be by 0.1 s: simulate to the horizon, or declare what an early end means: after_end = "
        '"hold" (the last state stays) or "fail" (it violates the specification); or choose another --horizon'
    )
    assert len(decode((tmp_path / "a.mcap").read_bytes()).samples) == 20
    assert (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    ("system", "printed", "reason"),
    [
        ("fails", ["before"], "ZeroDivisionError: float division by zero (bad.py, line 14)"),
        ("crash", ["last words"], "`workers simulate` crashed (signal 6) in systems/bad.py, line 24"),
    ],
)
def test_a_failure_has_its_place_behind_what_was_printed(
    folder: Processes, tmp_path: Path, system: str, printed: list[str], reason: str
) -> None:
    failed = folder.run("perfbound", "simulate", f"systems/bad.py:{system}", "--x", "0.5", "--plot", tmp_path / "a.png")
    assert failed.code == 1
    assert failed.err.splitlines() == [*printed, f"perfbound: {reason}"]
    assert not list(tmp_path.iterdir())


def test_a_failed_attempt_of_a_campaign_has_its_place(folder: Processes, tmp_path: Path) -> None:
    question = 'max_tests = 5\nclaims = [{ quantity = "failure_probability" }]\n'
    text = f'horizon = 5\nspecification = "always (a >= 0)"\n{question}'
    (folder.folder / "c.toml").write_text(f"{text}system.python = 'systems/bad.py:fails'\nspace.x = [0, 1]\n")
    file = folder.folder / "c.toml"
    failed = folder.run("perfbound", "run", file, "--out", tmp_path / "run")
    assert failed.code == 1
    assert failed.last_line.count("ZeroDivisionError: float division by zero (bad.py, line 14)") == 1


def test_a_rollout_without_a_file_has_its_ranges(folder: Processes, tmp_path: Path) -> None:
    shown = folder.run("perfbound", "simulate", "test-function", "--x", "1,1")
    assert shown.code == 0, shown.err
    assert [line.split()[0] for line in shown.out.splitlines()] == ["column", "t", "value", "horizon"]
    assert not list(tmp_path.iterdir())


# new-system


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("package") / "my-robot"
    list(write_package("my-robot", folder))
    return folder


@pytest.fixture(scope="module")
def installed(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of an environment with the new package, installed without network."""
    folder = tmp_path_factory.mktemp("installed")
    python = environment(folder / "venv")
    # What this environment has, also its editable installation of perfbound.
    here = next(path for path in map(Path, sys.path) if (path / "pydantic").is_dir())
    (site_packages(python) / "here.pth").write_text(f"{ROOT}\nimport site; site.addsitedir({str(here)!r})\n")
    quiet = ("-m", "pip", "--quiet", "--disable-pip-version-check", "--python", python, "install")
    options = ("--no-deps", "--no-index", "--no-build-isolation")
    call([sys.executable, *quiet, *options, package], folder, PYTHONPATH=str(backend(folder)))
    return python.parent


def test_the_new_package_is_installed_tested_and_certified(installed: Path, package: Path, tmp_path: Path) -> None:
    call([installed / "python", "-m", "pytest", "-q", "-p", "no:cacheprovider"], package, PYTHONPATH="")
    perfbound = (installed / "python", "-P", "-m", "perfbound.orchestrator")
    listed = call([*perfbound, "systems"], tmp_path, PYTHONPATH="")
    assert "my-robot: Brake at once, with a deceleration that varies by a tenth.\n" in listed
    arguments = ("my-robot", "--specification", "always (distance >= 0)")
    call([*perfbound, "init", *arguments], tmp_path, PYTHONPATH="")
    shortened(tmp_path / "my-robot.toml", 4)
    call([*perfbound, "run", "my-robot.toml", "--out", "run"], tmp_path, PYTHONPATH="")
    found = Certificate.model_validate_json((tmp_path / "run" / "certificate.json").read_bytes())
    assert found.predicate.software["my-robot"] == "0.1.0"
    checks = json.loads(call([*perfbound, "verify", "run", "--resimulate", "2", "--json"], tmp_path, PYTHONPATH=""))
    assert {each["status"] for each in checks["checks"]} <= {"passed", "skipped"}


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("\n1 / 0", "my-robot: it cannot be loaded: ZeroDivisionError: division by zero (my_robot.py, line 2)"),
        (
            BAD.replace("def huge", "def my_robot_2"),
            "leads to 'my-robot-2'; give both the same name",
        ),
    ],
)
def test_a_package_that_cannot_be_loaded_says_why(folder: Processes, tmp_path: Path, code: str, words: str) -> None:
    (tmp_path / "my_robot.py").write_text(code)
    about = tmp_path / "my_robot-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-robot\nVersion: 1\n")
    last = "my_robot_2" if "my_robot_2" in code else "none"
    (about / "entry_points.txt").write_text(f"[perfbound.systems]\nmy-robot = my_robot:{last}\n")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    refused = folder.run("perfbound", "systems", "my-robot", PYTHONPATH=path)
    assert refused.code == 1
    assert words in refused.fault


def test_a_new_package_overwrites_nothing(folder: Processes, tmp_path: Path) -> None:
    place = tmp_path / "robot"
    assert folder.run("perfbound", "new-system", "robot", "--out", place).code == 0
    before = contents(place)
    refused = folder.run("perfbound", "new-system", "robot", "--out", place)
    assert f"{place}: exists already and stays as it is; choose another --out" in refused.fault
    assert contents(place) == before
