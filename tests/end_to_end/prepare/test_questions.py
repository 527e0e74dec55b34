"""The page of the questions as a newcomer follows it: each file, command and claim; and the files of `init`."""

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from perfbound.orchestrator.prepare.init.file import MOST_KEYS, key_lines
from perfbound.orchestrator.prepare.init.questions import QUESTIONS
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Processes
from tests.end_to_end.report.pages import EXAMPLES, PAGE

ROOT = Path(__file__).parents[3]
ELSEWHERE = {"box.toml", "often.toml", "requirements.toml", "each.toml"}
"""Files of the page that `test_kriging` and `test_sample` run."""


def test_every_file_of_the_page_is_an_example() -> None:
    assert len(EXAMPLES) == PAGE.count("```toml") == 8
    for name, example in EXAMPLES.items():
        assert example.command == name
        assert key_lines(example.file) <= MOST_KEYS


@pytest.mark.parametrize("name", sorted(EXAMPLES.keys() - ELSEWHERE))
def test_a_file_of_the_page_gives_the_claims_of_the_page(started: Processes, tmp_path: Path, name: str) -> None:
    EXAMPLES[name].check(EXAMPLES[name].run(started, tmp_path))


# The files of `perfbound init`

DETERMINISTIC = """import numpy as np
import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"a": "m"}, step=0.1)
def slope(x):
    return 0.01 * np.arange(31.0) + np.sin(x)
"""
QUANTITIES = {
    "worst": {"expected_robustness", "robustness"},
    "fails": {"failure_probability"},
    "safe": {"expected_robustness", "robustness", "safe_share"},
    "how-often": {"failure_probability"},
    "worst-cases": {"quantile"},
    "next": {"next_rollout"},
}


@pytest.fixture(scope="module")
def systems(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a noisy and a deterministic function, and a deterministic and a noisy program."""
    folder = tmp_path_factory.mktemp("systems")
    shutil.copy(ROOT / "deploy" / "examples" / "cars" / "cars.py", folder)
    (folder / "slope.py").write_text(DETERMINISTIC)
    for noisy in ("false", "true"):
        (folder / f"program-{noisy}.toml").write_text(
            f'[system]\nprogram = ["./one.sh"]\ncolumns = {{ a = "m" }}\nnoisy = {noisy}\n[space]\nx = [0, 1]\n'
        )
    program = folder / "one.sh"
    # One sample, the start and a little that depends on the last digit of the seed.
    program.write_text(
        """#!/bin/sh
while read -r line; do
  printf '%s\\n' "$line" | awk -F '[][{}:," ]+' '{ printf "0,%.17g\\n", $4 + 0.001 * ($6 % 10) > $(NF - 1) }'
  echo '{"done": true}'
done
"""
    )
    program.chmod(0o755)
    return folder


@pytest.mark.parametrize("question", [name for name, each in QUESTIONS.items() if len(each.problems) == 1])
@pytest.mark.parametrize("system", ["cars.py:cars", "slope.py:slope", "program-false.toml", "program-true.toml"])
def test_the_file_of_init_runs_at_once_to_its_claim(
    started: Processes, systems: Path, question: str, system: str
) -> None:
    file = systems / f"{question}-{re.sub('[^a-z]', '', system)}.toml"
    written = started.run("perfbound", "init", systems / system, "--question", question, "--out", file)
    assert written.code == 0, written.err
    assert written.out.splitlines()[-1].endswith(f"Then: perfbound run {file}")
    text = file.read_text()
    assert key_lines(text) <= MOST_KEYS
    assert "guessed" not in written.out
    # Fewer tests: their number is that of a minute.
    least = 59 if QUESTIONS[question].drawn else 5
    short = re.sub(r"^max_tests = \d+$", f"max_tests = {least}", text, flags=re.MULTILINE).replace("0.01 }", "0.05 }")
    file.write_text("spot_check = 6\nspot_check_followups = 4\nrecheck = 3\n" + short)
    assert tomllib.loads(short) != {}
    ended = started.run("perfbound", "run", file, "--out", file.with_suffix(""))
    assert ended.code == 0, ended.err
    found = Certificate.model_validate_json((file.with_suffix("") / "certificate.json").read_bytes())
    assert found.predicate.claims[0].quantity in QUANTITIES[question]


def test_an_unknown_question_names_all(started: Processes, systems: Path) -> None:
    refused = started.run("perfbound", "init", systems / "cars.py:cars", "--question", "frequency")
    assert refused.code == 1
    assert "--question frequency: there is no such question; choose one of worst (How bad is the worst" in refused.fault


MANY = """import perfbound as pb


@pb.system(parameters={name: pb.Parameter(0, 1) for name in "abcd"}, columns={"x": "m"}, step=0.1)
def many(a, b, c, d, *, seed, horizon):
    return [[2 + a - b * c + 0.1 * d + 0.001 * (seed % 7)] * 11]
"""


def test_the_worst_start_of_four_parameters_is_asked_by_a_file_that_runs(started: Processes, tmp_path: Path) -> None:
    (tmp_path / "many.py").write_text(MANY)
    asked = ("--question", "worst", "--specification", "always (x >= 0)", "--horizon", "1")
    made = started.run("perfbound", "init", tmp_path / "many.py:many", *asked, "--out", tmp_path / "w.toml")
    assert made.code == 0, made.err
    ended = started.run("perfbound", "run", tmp_path / "w.toml", "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    assert "at the worst of the 4,096 listed starts" in ended.out
    assert "Spot check: " in ended.out
