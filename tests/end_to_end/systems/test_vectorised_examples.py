"""The examples of vectorised systems, as they are shipped: checked, run in batches and verified."""

import json
import shutil
from pathlib import Path

from perfbound.orchestrator.certificate.verify.checks import ABSENT
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Processes

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


def test_the_cars_fail_rarely(started: Processes, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(EXAMPLES / "cars", tmp_path / "cars"))
    file = folder / "cars-rare.toml"
    # A tenth of the rollouts, for ten times the probability.
    file.write_text(file.read_text().replace("299_573", "29_957").replace("= 1e-5", "= 1e-4"))
    ended = started.run("perfbound", "run", file, "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    (claim, *_) = Certificate.model_validate_json((tmp_path / "run/certificate.json").read_bytes()).predicate.claims
    assert claim.bound <= 1e-4
    reference = f"{folder / 'many_cars.py'}:cars"
    verify = ("perfbound", "verify", tmp_path / "run", "--resimulate", "2", "--json", "--system", reference)
    found = {each["check"]: each["status"] for each in json.loads(started.run(*verify).out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) == {"signature"}
