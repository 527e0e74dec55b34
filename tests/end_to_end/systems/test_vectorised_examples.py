"""The examples of vectorised systems, as they are shipped: checked, run in batches and verified."""

import importlib.util
import json
import shutil
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate.verify.checks import ABSENT
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Processes

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


def run_and_verify(started: Processes, campaign: Path, system: str, directory: Path) -> float:
    """Return the bound of the first claim."""
    ended = started.run("perfbound", "run", campaign, "--out", directory)
    assert ended.code == 0, ended.err
    (claim, *_) = Certificate.model_validate_json((directory / "certificate.json").read_bytes()).predicate.claims
    reference = f"{campaign.parent / system}"
    verify = ("perfbound", "verify", directory, "--resimulate", "2", "--json", "--system", reference)
    found = {each["check"]: each["status"] for each in json.loads(started.run(*verify).out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) == {"signature"}
    assert claim.bound is not None
    return claim.bound


def test_the_cars_fail_rarely(started: Processes, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(EXAMPLES / "cars", tmp_path / "cars"))
    file = folder / "cars-rare.toml"
    # A tenth of the rollouts, for ten times the probability.
    file.write_text(file.read_text().replace("299_573", "29_957").replace("= 1e-5", "= 1e-4"))
    assert run_and_verify(started, file, "many_cars.py:cars", tmp_path / "run") <= 1e-4


@pytest.mark.parametrize(
    ("name", "required"),
    [
        ("swing", 1e-3),
        pytest.param(
            "satellite",
            1e-4,
            marks=pytest.mark.skipif(importlib.util.find_spec("jax") is None, reason="JAX is not installed: make jax"),
        ),
    ],
)
def test_a_simulator_of_batches_shows_what_its_page_says(
    started: Processes, tmp_path: Path, name: str, required: float
) -> None:
    folder = Path(shutil.copytree(EXAMPLES / name, tmp_path / name))
    bound = run_and_verify(started, folder / f"{name}.toml", f"{name}.py:{name}", tmp_path / "run")
    assert bound <= required
    checked = started.run("perfbound", "check-system", folder / f"{name}.toml", "--json")
    assert checked.code == 0, checked.out
    (batches,) = [each for each in json.loads(checked.out)["checks"] if each["check"] == "batches"]
    assert batches["status"] == "passed"
