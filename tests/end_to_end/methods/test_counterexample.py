"""The search for a counterexample as a user does it: one flag, then the command that the output ends with."""

import json
import shlex
import shutil
from pathlib import Path

import pytest

from tests.end_to_end.processes import processes

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "cars"


@pytest.mark.journey
def test_a_counterexample_is_found_verified_and_repeated_by_the_printed_command(tmp_path: Path) -> None:
    shutil.copy(EXAMPLE / "cars.py", tmp_path)
    campaign, run = tmp_path / "cars.toml", tmp_path / "run"
    text = (EXAMPLE / "cars.toml").read_text()
    assert "gap = { low = 20," in text
    campaign.write_text(text.replace("gap = { low = 20,", "gap = { low = 5,"))
    with processes(tmp_path) as started:
        found = started.run("perfbound", "run", campaign, "--until-counterexample", "--out", run)
        assert found.code == 0, found.err
        lines = [line for line in found.out.splitlines() if line]
        assert lines[0] == "VERDICT  VIOLATED"
        assert any(line.startswith("COUNTEREXAMPLE  test ") for line in lines)
        certificate = json.loads((run / "certificate.json").read_text())["predicate"]
        assert certificate["problems"][0]["tests"] < 60
        assert certificate["counterexample"]["robustness"] < 0
        (again,) = (line for line in lines if line.startswith("draw it "))
        program, *arguments = shlex.split(again.removeprefix("draw it "))
        repeated = started.run(program, *arguments)
        assert repeated.code == 0, repeated.err
        assert "bitwise the same as the recorded trajectory" in repeated.out
        assert (tmp_path / "counterexample.png").exists()
        assert started.run("perfbound", "verify", run).code == 0
