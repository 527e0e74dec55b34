"""The example with MuJoCo, as it is shipped: the same bytes whatever happens, and the result that its page shows."""

import json
import re
import shutil
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate.verify.checks import ABSENT
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Processes, processes, recorded, wait_for

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "cartpole"
REPEATS = """
from perfbound.workers.systems.files import load_file
system = load_file("cartpole.py:cartpole")
for start, seed in (((0.3, 0.8), 1), ((0.5, 2.0), 2), ((0.3, 0.8), 1)):
    found = system.rollout(start, variant="nominal", seed=seed, horizon=3.0, options={}, progress=lambda step: None)
    print(found.samples.tobytes().hex())
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the example, with a finished run in `runs/cartpole`."""
    found = Path(shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("examples") / "cartpole"))
    with processes(found / "logs") as started:
        ended = started.run("perfbound", "run", found / "cartpole.toml", "--out", found / "run")
    assert ended.code == 0, ended.err
    return found


def certificate(directory: Path) -> bytes:
    return (directory / "certificate.json").read_bytes()


def test_its_page_shows_its_result(folder: Path) -> None:
    (claim, *_) = Certificate.model_validate_json(certificate(folder / "run")).predicate.claims
    (shown,) = re.findall(r"over all starts >= ([\d.]+)", (EXAMPLE / "README.md").read_text())
    assert claim.bound == pytest.approx(float(shown), abs=1e-3)


def test_nothing_of_a_rollout_remains_for_the_next(started: Processes, folder: Path) -> None:
    shutil.copy(folder / "cartpole.py", started.folder)
    one, two = (started.run("python", "-c", REPEATS).out.split() for _ in range(2))
    assert one == two, "in another process"
    assert one[0] == one[2], "after another rollout"
    assert one[0] != one[1]


@pytest.mark.parametrize("workers", ["1", "3"])
def test_the_number_of_workers_changes_no_byte(started: Processes, folder: Path, tmp_path: Path, workers: str) -> None:
    run = started.run("perfbound", "run", folder / "cartpole.toml", "--out", tmp_path / "run", "--workers", workers)
    assert run.code == 0, run.err
    assert certificate(tmp_path / "run") == certificate(folder / "run")


def test_killed_it_resumes_to_the_same_bytes_and_verifies(started: Processes, folder: Path, tmp_path: Path) -> None:
    directory = tmp_path / "run"
    first = started.start("perfbound", "run", folder / "cartpole.toml", "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 50)
    assert first.running, "the kill has to come in mid-run"
    first.popen.kill()
    first.wait()
    assert started.run("perfbound", "resume", directory).code == 0
    assert certificate(directory) == certificate(folder / "run")
    reference = f"{folder / 'cartpole.py'}:cartpole"
    verified = started.run("perfbound", "verify", directory, "--resimulate", "5", "--json", "--system", reference)
    found = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) == {"signature"}
