"""Local workers that end: replaced, and a reason to stop only where they end by themselves."""

import subprocess
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from perfbound.orchestrator.fleet.children import processes
from perfbound.orchestrator.fleet.children.processes import FAST_DEATHS, Fleet
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.secret import VARIABLE
from tests.facts import facts

pytestmark = pytest.mark.integration


@pytest.fixture
def fleet(monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    """A fleet of one process that does nothing."""

    def spawn(found: Fleet) -> None:
        child = subprocess.Popen(["sleep", "1000"])
        found._children.append(processes._Child(key_expressions.fresh_id("local"), child, time.monotonic()))

    monkeypatch.setattr(Fleet, "_spawn", spawn)
    found = Fleet(1, ["tcp/127.0.0.1:1"], "run")
    found.start()
    yield found
    found.stop()


def ended(fleet: Fleet) -> str:
    """Wait until the process has ended; return the line of its replacement."""
    fleet._children[0].process.wait()
    (line,) = fleet.tend()
    return line


def test_workers_that_are_replaced_on_purpose_are_no_sign_that_none_can_run(fleet: Fleet) -> None:
    for _ in range(2 * FAST_DEATHS):
        worker = fleet._children[0].worker
        assert fleet.kill(worker)
        assert ended(fleet) == f"local worker {worker} replaced; started {fleet._children[0].worker}"
    assert not fleet.kill("local-ffffffff"), "none of ours"
    assert fleet.ended == {}


def test_how_a_worker_has_ended_by_itself_is_kept(fleet: Fleet) -> None:
    worker = fleet._children[0].worker
    fleet._children[0].process.kill()
    ended(fleet)
    assert fleet.ended == {worker: "signal 9"}


def test_workers_that_end_at_once_by_themselves_end_the_run(fleet: Fleet) -> None:
    for _ in range(FAST_DEATHS - 1):
        fleet._children[0].process.kill()
        assert "ended (signal 9)" in ended(fleet)
    fleet._children[0].process.kill()
    with pytest.raises(PerfboundError, match=facts("3 s 5 times")):
        ended(fleet)


def test_the_secret_is_in_no_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other users can read the arguments of a process, but not its environment."""
    started: list[tuple[list[str], dict[str, str]]] = []

    def popen(line: list[str], *, env: dict[str, str], **_: object) -> subprocess.Popen[bytes]:
        started.append((line, env))
        return subprocess.Popen(["sleep", "1000"])

    monkeypatch.setattr(processes, "subprocess", SimpleNamespace(Popen=popen, DEVNULL=None))
    fleet = Fleet(1, ["tcp/127.0.0.1:1"], "run", environment={VARIABLE: "a secret of a test"})
    fleet.start()
    monkeypatch.undo()
    fleet.stop()
    ((line, environment),) = started
    assert environment[VARIABLE] == "a secret of a test"
    assert environment["PATH"]
    assert not [part for part in line if "secret" in part]


def test_workers_that_end_together_count_once(fleet: Fleet) -> None:
    """Six workers that the kernel killed at once ended the campaign, although every next one could run."""
    while len(fleet._children) <= FAST_DEATHS:
        fleet._spawn()
    for child in fleet._children:
        child.process.kill()
        child.process.wait()
    assert len(fleet.tend()) == len(fleet._children) == FAST_DEATHS + 1
