"""Processes that the rollouts of a system in Python start, and that would outlive them: they end with their worker."""

import re
import secrets
import signal
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from ..processes import Process, Processes, arguments, recorded, wait_for

LEAVES = """
import subprocess, time
import perfbound as pb

@pb.system(parameters={{"x": pb.Parameter(0, 1)}}, columns={{"y": "m"}}, step=0.1)
def leaves(x):
    subprocess.Popen(["sleep", "{mark}"])
    subprocess.Popen(["sh", "-c", "setsid sleep {mark} & exit 0"])  # as a server does that becomes a daemon
    time.sleep({seconds})
    return [[x, x]]
"""
CAMPAIGN = """
horizon = 0.1
specification = "always (y >= 0)"
max_tests = 12
claims = [{ quantity = "failure_probability" }]
recheck = 2
[system]
python = "leaves.py:leaves"
[space]
x = [0, 1]
"""
NOTEBOOK = """
{system}
keys = {{"space": {{"x": (0, 1)}}, "specification": "always (y >= 0)", "horizon": 0.1, "max_tests": 12, "recheck": 2}}
pb.Campaign(leaves, claims=[{{"quantity": "failure_probability"}}], **keys).run("run")
"""
SECONDS = 0.2


class Left:
    """The processes of the rollouts of one test."""

    def __init__(self) -> None:
        self.mark = f"9{secrets.randbelow(10**9):09}"

    def now(self) -> int:
        return sum(self.mark in arguments(each) for each in psutil.process_iter())

    def system(self, seconds: float) -> str:
        return LEAVES.format(mark=self.mark, seconds=seconds)


@pytest.fixture
def left() -> Left:
    return Left()


@pytest.fixture
def folder(started: Processes, left: Left) -> Path:
    (started.folder / "leaves.py").write_text(left.system(0.0))
    (started.folder / "c.toml").write_text(CAMPAIGN)
    return started.folder


def ended(text: str) -> int:
    """Return how many were ended, by the line that says so."""
    return int(re.findall(r"^(\d+) processes that rollouts had started were still there", text, re.MULTILINE)[0])


@pytest.mark.journey
def test_they_end_with_the_campaign_and_are_counted(started: Processes, folder: Path, left: Left) -> None:
    found = started.run("perfbound", "run", "c.toml", "--workers", "2", "--out", "run")
    assert found.code == 0, found.err
    assert ended(found.out + found.err) >= 2 * 14, "two of each rollout"
    assert left.now() == 0


def test_a_single_rollout_leaves_none(started: Processes, folder: Path, left: Left) -> None:
    line = ("simulate", "leaves.py:leaves", "--x", "0.5", "--horizon", "0.1", "--out", "a.mcap")
    found = started.run("perfbound", *line)
    assert found.code == 0, found.err
    assert left.now() == 0


def kill_orchestrator(process: Process) -> None:
    process.popen.kill()


def kill_worker(process: Process) -> None:
    process.children_with("serve")[0].kill()


def interrupt(process: Process) -> None:
    process.popen.send_signal(signal.SIGINT)


@pytest.mark.parametrize("end", [kill_orchestrator, kill_worker, interrupt])
def test_they_end_however_the_campaign_does(
    started: Processes, folder: Path, left: Left, end: Callable[[Process], None]
) -> None:
    (folder / "leaves.py").write_text(left.system(SECONDS))
    process = started.start("perfbound", "run", "c.toml", "--workers", "1", "--out", "run")
    wait_for(lambda: recorded(folder / "run") >= 3)
    assert left.now() >= 6
    end(process)
    process.wait()
    wait_for(lambda: left.now() == 0)


def test_those_of_a_function_in_a_notebook_end_as_well(started: Processes, folder: Path, left: Left) -> None:
    script = NOTEBOOK.format(system=left.system(0.0))
    (folder / "cell.py").write_text(f"exec(compile({script!r}, '<cell>', 'exec'))\n")
    found = started.run("python", "-c", (folder / "cell.py").read_text())
    assert found.code == 0, found.err
    assert ended(found.out + found.err) >= 2 * 14
    assert left.now() == 0
