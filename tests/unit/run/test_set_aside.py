"""A worker that is set aside, from the failed attempts to the line, the database, the status and the live page."""

import io
import itertools
import json
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from perfbound.orchestrator.cli.status import print_status
from perfbound.orchestrator.run.display.progress import worker_line
from perfbound.orchestrator.run.page.page_feed import message
from perfbound.orchestrator.run.service import RunStatus
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.link.messages import ResultHeader, WorkerState
from perfbound.schemas.rollout import RolloutRequest
from perfbound.workers import worker as module
from perfbound.workers.systems.base import Progress, SystemUnderTest
from tests.campaigns import UNCHECKED
from tests.facts import facts, says
from tests.fakes.altering import AlteringUplink
from tests.fakes.inmemory import InMemoryUplink, Log, Network, begin, campaign, hurry, run_of, serve, working

PRESET = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"
CONFIG = parse_campaign(
    PRESET.read_bytes(), "test", **{"resolution": 11, "max_tests": 12, "replicates": 3, **UNCHECKED}
)


class BrokenNode(AlteringUplink):
    """The uplink of a worker of another host that fails in everything."""

    def report(self, state: WorkerState) -> None:
        """Report another host."""
        super().report(state.model_copy(update={"host": "far"}))

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Fail."""
        failed = {"outcome": "failed", "sha256": "", "error": "no \x1b[31msimulator", "kind": "infrastructure"}
        super().deliver(header.model_copy(update=failed), b"")


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything as it is, in a tenth of the time."""
    hurry(monkeypatch, tick=0.02)


def test_a_broken_worker_is_named_set_aside_and_changes_nothing(tmp_path: Path) -> None:
    log, directory, seen = Log(), tmp_path / "run", list[RunStatus]()
    begin(directory, CONFIG)

    def look(status: RunStatus) -> bool:
        seen.append(status)
        return False

    honest: Callable[[InMemoryUplink], InMemoryUplink] = lambda uplink: uplink  # noqa: E731
    with Network() as network, working(network, run_of(directory), [BrokenNode, honest, honest]):
        found = serve(directory, network, log, stop=look)
    assert found == campaign(tmp_path / "calm", CONFIG)
    (line,) = [line for line in log.lines if "set aside" in line]
    assert line.startswith("worker worker-0")
    assert says(line, "30 s: 3 rollouts last: \\x1b[31msimulator")
    name = line.split()[1]
    (pauses,) = read_progress(directory).pauses
    assert (pauses.kind, pauses.name, pauses.count) == ("worker", name, 1)
    assert pauses.reason.endswith("simulator")
    console = Console(record=True, width=200, file=io.StringIO())
    print_status(directory, console)
    assert says(console.export_text(), f"{name}: 1 time 3 rollouts last:")
    last = seen[-1]
    assert last.workers[name] == "set aside"
    assert f"in trouble: {name}" in worker_line(last, 1.0)
    assert json.loads(message(last))["workers"][name][0] == "set aside"


@pytest.mark.integration
def test_a_system_that_does_not_end_costs_two_deadlines_and_is_reported_with_its_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(_system: SystemUnderTest, _request: RolloutRequest, progress: Progress) -> bytes:
        for step in itertools.count():
            progress(step)
            time.sleep(0.01)
        raise AssertionError

    monkeypatch.setattr(module, "run_on", endless)
    config = CONFIG.model_copy(update={"deadline": 1.0})
    with pytest.raises(PerfboundError, match=facts("2 times : 1 s deadline = 1 s")) as end:
        campaign(tmp_path / "run", config, workers=1)
    assert "deadline = 1 s at the start (" in str(end.value)
    assert "attempt 2 on worker-0" in str(end.value)


def test_the_end_of_a_pause_is_written_too(tmp_path: Path) -> None:
    begin(tmp_path / "run", CONFIG)
    journal = Journal.open(tmp_path / "run")
    with journal.transaction():
        journal.attempts.set_aside("host", "h", 30.0, "why")
    (before,) = read_progress(tmp_path / "run").pauses
    with journal.transaction():
        journal.attempts.set_aside("host", "h", 0.0, "")
    journal.close()
    (after,) = read_progress(tmp_path / "run").pauses
    assert (before.count, after.count, after.reason) == (1, 1, "why")
    assert after.until < before.until
