"""A function in a file beside the campaign file, from nothing to its verified certificate."""

import json
import re
import shutil
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate.verify.checks import ABSENT
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Ended, Processes, processes, query, recorded, wait_for

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "cars"
CHECKS = "spot_check = 6\nspot_check_followups = 4\nrecheck = 3\n"


def copied(folder: Path, *, tests: int = 8) -> Path:
    """Copy the example, with short checks and few tests; return its campaign file."""
    shutil.copytree(EXAMPLE, folder)
    file = folder / "cars.toml"
    file.write_text(CHECKS + file.read_text().replace("max_tests = 60", f"max_tests = {tests}"))
    return file


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("own") / "cars"
    copied(found)
    return found


@pytest.fixture(scope="module")
def ended(folder: Path) -> Ended:
    """A run without trouble, in the folder `run`."""
    with processes(folder / "logs") as found:
        return found.run("perfbound", "run", folder / "cars.toml", "--out", folder / "run")


def certificate(directory: Path) -> bytes:
    return (directory / "certificate.json").read_bytes()


def test_the_certificate_names_the_code(ended: Ended, folder: Path) -> None:
    assert ended.code == 0, ended.err
    claim = next(line for line in ended.out.splitlines() if line.startswith("CLAIM"))
    assert claim.startswith("CLAIM  worst expected robustness, clipped to [-20, 60], over all starts >= ")
    assert claim.endswith(" m"), "the unit of distance, the only column of the specification"
    command = ended.out.splitlines()[-1].removeprefix("check it ").split()
    assert command[:2] + command[3:6] == ["perfbound", "verify", "--resimulate", "5", "--system"]
    assert command[6].endswith("cars.py:cars")
    found = Certificate.model_validate_json(certificate(folder / "run")).predicate
    assert found.question["system"] == {"python": "cars.py:cars", "reaction": 0.6}
    assert len(found.software["cars.py"].removeprefix("sha256 ")) == 64


@pytest.mark.usefixtures("ended")
@pytest.mark.parametrize("workers", [1, 3])
def test_the_number_of_workers_changes_no_byte(started: Processes, folder: Path, tmp_path: Path, workers: int) -> None:
    run = started.run("perfbound", "run", folder / "cars.toml", "--out", tmp_path / "run", "--workers", str(workers))
    assert run.code == 0, run.err
    assert certificate(tmp_path / "run") == certificate(folder / "run")


@pytest.mark.usefixtures("ended")
def test_killed_it_resumes_from_anywhere_and_verifies(started: Processes, folder: Path, tmp_path: Path) -> None:
    directory = tmp_path / "run"
    first = started.start("perfbound", "run", folder / "cars.toml", "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 10)
    assert first.running, "the kill has to come in mid-run"
    first.popen.kill()
    first.wait()
    # From another folder: the journal names the file.
    assert started.run("perfbound", "resume", directory).code == 0
    assert certificate(directory) == certificate(folder / "run")
    verify = ("perfbound", "verify", directory, "--resimulate", "3", "--json")
    verified = started.run(*verify, "--system", f"{folder / 'cars.py'}:cars")
    found = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) == {"signature"}
    alone = started.run(*verify)
    failed = [each for each in json.loads(alone.out)["checks"] if each["status"] == "failed"]
    assert [each["check"] for each in failed] == ["resimulation"], "a certificate names no code that is run"
    assert "--system" in failed[0]["detail"]


WORLD = """
import os

import perfbound

WORLD = int.from_bytes(os.urandom(4)) / 2**32


@perfbound.system(parameters={"z": perfbound.Parameter(0, 1)}, columns={"v": ""})
def world(z):
    return WORLD - 0.5 + 0.0 * z
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_process_draws_at_its_start_shows(started: Processes, tmp_path: Path, workers: int) -> None:
    """A rollout that no other process repeats: with one worker the recheck is made by a fresh one."""
    (tmp_path / "world.py").write_text(WORLD)
    keys = ['python = "world.py:world"', "[space]", "z = { low = 0, high = 1 }"]
    head = (
        'specification = "v >= 0"\nalpha = 0.01\nnoise_scale = 0.0\nrkhs_norm = 2.0\nprior_mean = 0.0\nspot_check = 5\n'
    )
    kernel = "max_tests = 10\nkernel = { length_scale = 0.5 }\n[system]\n"
    (tmp_path / "w.toml").write_text(head + kernel + "\n".join(keys))
    ended = started.run("perfbound", "run", tmp_path / "w.toml", "--workers", str(workers), "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    assert "VERDICT  NOT SHOWN" in ended.out
    assert "reproducible_rollouts" in ended.out


def test_a_changed_function_does_not_resume(started: Processes, tmp_path: Path) -> None:
    file, directory = copied(tmp_path / "cars"), tmp_path / "run"
    first = started.start("perfbound", "run", file, "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 5)
    first.popen.kill()
    first.wait()
    code = tmp_path / "cars" / "cars.py"
    before = code.read_text()
    code.write_text(before.replace("7 * np.maximum", "9 * np.maximum"))
    refused = started.run("perfbound", "resume", directory)
    assert refused.code == 1
    assert "this campaign was started: cars.py is another one here; resume it with the files of then" in (
        refused.last_line
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "cars.py").write_text(before)
    assert started.run("perfbound", "resume", directory, "--system", f"{elsewhere / 'cars.py'}:cars").code == 0


def test_modules_of_pythonpath_are_part_of_the_campaign(started: Processes, tmp_path: Path) -> None:
    """The simulator lies outside the folder of the system, elsewhere on another machine, and does not change."""
    file, directory = copied(tmp_path / "cars"), tmp_path / "run"
    code = file.with_name("cars.py")
    simulators = [tmp_path / name for name in ("here", "there")]
    for each in simulators:
        each.mkdir()
        shutil.copy(code, each / "simulator.py")
    code.write_text("from simulator import cars\n")
    first = started.start("perfbound", "run", file, "--out", directory, "--workers", "1", PYTHONPATH=str(simulators[0]))
    wait_for(lambda: recorded(directory) >= 5)
    first.popen.kill()
    first.wait()
    before = (simulators[0] / "simulator.py").read_text()
    (simulators[0] / "simulator.py").write_text(before.replace("7 * np.maximum", "9 * np.maximum"))
    refused = started.run("perfbound", "resume", directory, PYTHONPATH=str(simulators[0]))
    assert refused.code == 1
    assert "this campaign was started: module simulator is another one here" in refused.last_line
    assert started.run("perfbound", "resume", directory, PYTHONPATH=str(simulators[1])).code == 0
    software = Certificate.model_validate_json(certificate(directory)).predicate.software
    assert {"cars.py", "module simulator"} < software.keys()
    verify = ("perfbound", "verify", directory, "--resimulate", "2", "--system", f"{code}:cars")
    other = started.run(*verify, PYTHONPATH=str(simulators[0]))
    assert (other.code, "module simulator" in other.out + other.err) == (1, True)
    assert started.run(*verify, PYTHONPATH=str(simulators[1])).code == 0


def test_workers_elsewhere_need_the_same_code(started: Processes, folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "cars.py"
    other.write_text((folder / "cars.py").read_text() + "\n# another one\n")
    server = started.start("perfbound", "orchestrate", folder / "cars.toml", "--out", tmp_path / "run")
    wait_for(lambda: "waiting for workers" in server.err)
    endpoint = server.err.split("--connect ")[1].split()[0]
    connect = ("perfbound-worker", "--connect", endpoint, "--system")
    refused = started.run(*connect, f"{other}:cars")
    assert refused.code == 1
    assert "the worker's 'cars' has another or no cars.py than the campaign's; use the same on both" in refused.err
    worker = started.start(*connect, f"{folder / 'cars.py'}:cars")
    assert server.wait().code == 0
    worker.popen.terminate()
    assert not (folder / "run").exists() or certificate(tmp_path / "run") == certificate(folder / "run")


@pytest.mark.parametrize(
    ("system", "words"),
    [
        ('python = "bikes.py:cars"', "there is no such Python file"),
        ('python = "cars.py:bikes"', "there is no 'bikes' in it"),
        ('python = "cars.py"', "python: 'cars.py' is not allowed: allowed is"),
        ('name = "cars"', "'cars' is not an installed system; allowed are segway, segway-mujoco, test-function"),
        ('name = "segway"\npython = "cars.py:cars"', 'give one of name = "...", an installed system, python'),
        (
            'python = "cars.py:cars"\nreactoin = 0.5',
            "system.reactoin: unknown key; did you mean 'reaction'? allowed for cars are",
        ),
    ],
)
def test_a_system_that_cannot_be_used_is_one_line(
    started: Processes, folder: Path, tmp_path: Path, system: str, words: str
) -> None:
    file = tmp_path / "cars.toml"
    text = (folder / "cars.toml").read_text().replace('python = "cars.py:cars"\nreaction = 0.6', system)
    assert system in text
    file.write_text(text)
    shutil.copy(folder / "cars.py", tmp_path)
    refused = started.run("perfbound", "run", file, "--out", tmp_path / "run")
    assert refused.code == 1
    assert words in refused.fault
    assert not (tmp_path / "run").exists()


def test_a_forgotten_horizon_is_refused(started: Processes, folder: Path, tmp_path: Path) -> None:
    """With the horizon 0 of a function without time, the rollout would be one harmless sample."""
    file = tmp_path / "cars.toml"
    file.write_text((folder / "cars.toml").read_text().replace("horizon = 8.0\n", ""))
    shutil.copy(folder / "cars.py", tmp_path)
    refused = started.run("perfbound", "run", file, "--out", tmp_path / "run")
    assert "horizon: this key is required: cars takes the duration of a rollout, in s" in refused.fault


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_function_that_fails_ends_with_its_command_and_remedy(
    started: Processes, tmp_path: Path, workers: str
) -> None:
    file = copied(tmp_path / "cars")
    code = tmp_path / "cars" / "cars.py"
    code.write_text(
        code.read_text().replace("    t = np.arange", "    assert gap > 21, 'too close'\n    t = np.arange")
    )
    failed = started.run("perfbound", "run", file, "--out", tmp_path / "run", "--workers", workers)
    assert failed.code == 1
    line = failed.last_line
    assert line.count("AssertionError: too close") == 1, "each reason once"
    # A third time where the second worker had failed others before: set aside, it counts against itself alone.
    attempts = r"failed [23] times.*: Ass.*? \(attempt 1 on (\S+), attempt 2 on ([^ ,)]+)(?:, attempt 3 on \S+)?\)\. "
    rollout = re.search(rf"rollout (\S+) {attempts}", line)
    assert rollout is not None, line
    assert rollout[2] != rollout[3], "on another worker, or in a fresh process"
    told = [each for each in failed.err.splitlines() if f"{rollout[1]}, attempt" in each]
    assert len(told) == 1, told
    assert "If the code of the system is wrong, fix it and start a new campaign" in line
    command = line.split("Repeat it: ")[1].split(". If")[0].split()
    assert command[2].endswith("cars.py:cars")
    again = started.run(*command[:-1], tmp_path / "one.mcap")
    assert "too close" in again.last_line


def test_a_reference_is_described_and_simulated(started: Processes, folder: Path, tmp_path: Path) -> None:
    reference = f"{folder / 'cars.py'}:cars"
    described = started.run("perfbound", "systems", reference)
    assert "option    reaction = 0.5 (allowed: a number)" in described.out, described.err
    file = tmp_path / "one.mcap"
    simulated = started.run("perfbound", "simulate", reference, "--x", "20,30", "--horizon", "8", "--out", file)
    assert simulated.code == 0, simulated.err
    assert file.stat().st_size > 0


@pytest.mark.usefixtures("ended")
def test_a_rollout_is_replayed(started: Processes, folder: Path) -> None:
    replay = ("perfbound", "replay", folder / "run", "robustness.0.nominal.0")
    replayed = started.run(*replay, "--system", f"{folder / 'cars.py'}:cars", "--out", folder / "one.png")
    assert "bitwise the same as the recorded trajectory" in replayed.out, replayed.err
    alone = started.run(*replay)
    assert "cars is a system in a file: name it with --system" in alone.last_line


def test_seeds_of_32_bits_are_those_that_the_function_gets(started: Processes, tmp_path: Path) -> None:
    file, directory, code = copied(tmp_path / "cars"), tmp_path / "run", tmp_path / "cars" / "cars.py"
    text = code.read_text().replace("    step=0.05,\n", "    step=0.05,\n    seed_bits=32,\n")
    # numpy's old generator takes nothing larger.
    code.write_text(text.replace("np.random.default_rng(seed)", "np.random.RandomState(seed)"))
    run = started.run("perfbound", "run", file, "--out", directory)
    assert run.code == 0, run.err
    seeds = {int(str(seed)) for (seed,) in query(directory, "SELECT seed FROM rollouts WHERE problem != 'recheck'")}
    assert len(seeds) == query(directory, "SELECT count(*) FROM rollouts WHERE problem != 'recheck'")[0][0]
    assert 2**31 < max(seeds) < 2**32
    verified = started.run("perfbound", "verify", directory, "--resimulate", "3", "--system", f"{code}:cars")
    assert verified.code == 0, verified.out
    one = ("perfbound", "simulate", f"{code}:cars", "--x", "20,30", "--horizon", "8", "--out", tmp_path / "one.mcap")
    assert started.run(*one, "--seed", str(2**32 - 1)).code == 0
    refused = started.run(*one, "--seed", str(2**32))
    assert refused.fault == "perfbound: --seed 4294967296: cars takes 0 to 4294967295; choose a smaller one"


@pytest.mark.usefixtures("ended")
def test_the_report_names_folder_and_revision(folder: Path) -> None:
    """The folder of the tests is in no repository; that of the file is named."""
    report = (folder / "run" / "report.html").read_text()
    assert f"{folder / 'cars.py'}:cars" in report
    assert str(folder) not in certificate(folder / "run").decode(), "the certificate depends on no folder"
