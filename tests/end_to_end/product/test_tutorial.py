"""The commands of the tutorial, as they are typed, one after the other; its campaigns are shortened."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.campaigns import FOLDER
from tests.end_to_end.processes import BIN, Ended, Processes, processes, wait_for
from tests.patience import PATIENCE

ROOT = Path(__file__).parents[3]
SHORT = {"horizon": "2.0", "max_tests": "5", "spot_check": "3", "spot_check_followups": "3", "recheck": "3"}
"""Keys of a campaign that is run for its output files alone."""


class Step(NamedTuple):
    """A command of the tutorial, and how its first line of output begins, if the tutorial shows one."""

    command: str
    output: str


def steps(text: str) -> Iterator[Step]:
    """Yield the indented commands of a page with the first word of the block that follows."""
    for command, output in re.findall(r"\n\n {4}(\S[^\n]*)\n(?:\n```text\n(\S+))?", text):
        yield Step(command, output)


STEPS = tuple(steps((ROOT / "docs" / "tutorial.md").read_text()))


def shortened(text: str) -> str:
    """Return a campaign file with a short rollout and few tests; every problem keeps what the tutorial names."""
    head, table, tail = text.partition("[system]")
    for key, value in SHORT.items():
        head, found = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", head)
        head = head if found else f"{key} = {value}\n{head}"
    # Enough tests for the rollout that the tutorial repeats.
    return head + table + re.sub(r"(?m)^max_tests = .*$", "max_tests = 90", tail)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """A checkout in which every command is typed, with a home of its own."""
    place = tmp_path_factory.mktemp("checkout")
    (place / "deploy" / "campaigns").mkdir(parents=True)
    for file in FOLDER.glob("*.toml"):
        (place / "deploy" / "campaigns" / file.name).write_text(shortened(file.read_text()))
    with processes(place) as started:
        yield started


def typed(command: str, place: Path) -> Ended:
    home = {"HOME": str(place / "home"), "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    environment = {key: value for key, value in os.environ.items() if not key.startswith("XDG_")} | home
    (place / "home").mkdir(exist_ok=True)
    line = ["bash", "-c", command]
    ended = subprocess.run(
        line, cwd=place, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    return Ended(ended.returncode, ended.stdout, ended.stderr)


def test_the_tutorial_has_these_steps() -> None:
    """Commands that this file runs; another one needs a look at how long it takes here."""
    found = [" ".join(step.command.split()[:2]) for step in STEPS]
    assert found == [
        "make run",
        *(f"perfbound {each}" for each in ("show", "report", "export", "replay", "verify")),
        *(f"perfbound {each}" for each in ("keygen", "sign", "verify", "run")),
        "make run",
    ]


def test_every_command_runs_as_typed(folder: Processes) -> None:
    # In one test, in the order of the page: a later one reads what an earlier one has written.
    for command, output in STEPS:
        if command.endswith("--web"):
            process = folder.start(*command.split())
            wait_for(lambda: process.err.startswith(output) or not process.running)  # noqa: B023
            process.signal_group(signal.SIGINT)
            assert process.wait().code == 130, command
            continue
        ended = typed(of_make(command) if command.startswith("make") else command, folder.folder)
        assert ended.code == 0, f"{command}: {ended.err}"
        assert output == "..." or output in ended.out, command
    _results_page_reads(folder.folder)


def _results_page_reads(place: Path) -> None:
    """The code of the results page, with what the tutorial has written: a trajectory, tables, and a signature."""
    read, tables, signature = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "results.md").read_text(), re.DOTALL)
    # The tables are for pandas, which no test needs: their columns exist.
    names = ("tests", "rollouts")
    headers = [(place / f"runs/segway/export/{each}.csv").read_text().partition("\n")[0] for each in names]
    named = set(re.findall(r'"([a-z]+(?: \([a-z]+\))?)"', tables)) - {"round_trip", "true_risk"}
    assert named <= set(",".join(headers).split(",")), named
    found: dict[str, Any] = {}
    with contextlib.chdir(place):
        exec(read, found)
        assert len(found["phi"]) > 2
    shutil.copy(place / "home/.config/perfbound/keys/alice.pub", place / "runs/segway")
    with contextlib.chdir(place / "runs/segway"):
        exec(signature, found)
        assert found["certificate"] == json.loads(Path("certificate.json").read_text())


def of_make(command: str) -> str:
    """Return the command that a `make run` ends with, without the environment that it installs before."""
    campaign = command.partition("CAMPAIGN=")[2] or "deploy/campaigns/segway.toml"
    if shutil.which("make"):
        line = ["make", "-n", *command.split()[1:]]
        dry = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True)
        assert f"/perfbound run {campaign} --workers 2 --out runs/{Path(campaign).stem}" in dry.stdout
    return f"perfbound run {campaign}"
