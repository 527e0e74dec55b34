"""Each system without a function as docs/simulators.md has it: from its files to a certificate that others repeat."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.end_to_end.processes import Processes
from tests.fakes import fmus

PAGE = Path(__file__).parents[3] / "docs" / "simulators.md"


class Case(NamedTuple):
    """A section of the page."""

    title: str
    names: tuple[str, ...]
    """Of its files, in their order; the last one is the campaign."""
    ends: str
    """What the campaign prints."""
    file: str
    change: Callable[[Path], object]
    """It makes another system of this file, which is refused by its name."""


def replaced(old: str, new: str) -> Callable[[Path], object]:
    def change(path: Path) -> object:
        text = path.read_text()
        assert old in text
        return path.write_text(text.replace(old, new))

    return change


def leaking_more(path: Path) -> object:
    return fmus.written(path, 2, source=fmus.SOURCE.read_text().replace("[LEAK] = 0.2", "[LEAK] = 0.201"))


ENVIRONMENT = Case(
    "An environment of Gymnasium",
    ("policy.py", "pole.toml"),
    "COUNTEREXAMPLE",
    "policy.py",
    replaced("0.5 * rate", "0.6 * rate"),
)
CASES = (
    ENVIRONMENT,
    Case("An FMU", ("tank.toml",), "CLAIM", "Tank.fmu", leaking_more),
    Case(
        "A model for MuJoCo",
        ("pendulum.xml", "control.py", "pendulum.toml"),
        "COUNTEREXAMPLE",
        "pendulum.xml",
        replaced('mass="1"', 'mass="1.1"'),
    ),
    Case(
        "A model for MuJoCo",
        ("pendulum.xml", "control.py", "pendulum.toml"),
        "COUNTEREXAMPLE",
        "control.py",
        replaced("-12", "-12.5"),
    ),
)


def written(folder: Path, case: Case, *, tests: int = 300) -> Path:
    """Write the files of a section; return the campaign file."""
    section = PAGE.read_text(encoding="utf-8").partition(f"## {case.title}\n")[2].partition("\n## ")[0]
    blocks = re.findall(r"```(?:python|toml|xml)\n(.*?)```", section, re.DOTALL)
    for name, text in zip(case.names, blocks, strict=True):
        (folder / name).write_text(text)
    if case.file.endswith(".fmu"):
        if fmus.COMPILER is None:
            pytest.skip(fmus.NO_COMPILER)
        fmus.written(folder / case.file, 2)
    file = folder / case.names[-1]
    file.write_text("recheck = 3\n" + file.read_text().replace("max_tests = 300", f"max_tests = {tests}"))
    return file


@pytest.mark.parametrize(
    "case",
    [pytest.param(each, marks=[pytest.mark.journey] if each.title == "An FMU" else []) for each in CASES],
    ids=lambda case: case.file,
)
def test_the_page_leads_to_a_result_that_repeats_and_another_file_is_refused(started: Processes, case: Case) -> None:
    campaign = written(started.folder, case)
    ended = [
        started.run("perfbound", "run", campaign, "--out", started.folder / name, "--workers", workers)
        for name, workers in (("run", "2"), ("one", "1"))
    ]
    assert [each.code for each in ended] == [0, 0], ended
    assert "VIOLATED" in ended[0].out
    assert case.ends in ended[0].out
    assert "Warning" not in ended[0].err, "that an episode has ended is a column, and no warning"
    one, two = ((started.folder / name / "certificate.json").read_bytes() for name in ("run", "one"))
    assert one == two
    verify = ("perfbound", "verify", started.folder / "run", "--resimulate", "2", "--system", campaign)
    assert started.run(*verify).code == 0
    case.change(started.folder / case.file)
    refused = started.run(*verify)
    assert refused.code == 1
    assert f"{case.file} is another" in " ".join(refused.out.split())


@pytest.mark.parametrize("case", CASES[:3], ids=lambda case: case.file)
def test_check_system_finds_nothing_and_init_makes_a_campaign_of_a_description(started: Processes, case: Case) -> None:
    """The file with `[system]` and `[space]` alone."""
    campaign = written(started.folder, case, tests=20)
    text = campaign.read_text()
    found = json.loads(started.run("perfbound", "check-system", campaign, "--json").out)
    assert {each["status"] for each in found["checks"]} <= {"passed", "skipped"}, found
    description = started.folder / "description.toml"
    description.write_text("[system]" + text.partition("[system]")[2])
    (formula,) = re.findall('specification = "(.*)"', text)
    asked = ("--question", "how-often", "--specification", formula, "--horizon", "5")
    made = started.run("perfbound", "init", description, "--out", started.folder / "made.toml", *asked)
    assert made.code == 0, made
    assert f'"{case.file}' in (started.folder / "made.toml").read_text()
    assert started.run("perfbound", "run", started.folder / "made.toml", "--out", started.folder / "made").code == 0
