"""The times of heartbeats: at the interval that was set, at once on a change, and as before for a new orchestrator."""

import pytest

from perfbound.schemas.link.messages import HEARTBEAT, HeartbeatInterval
from perfbound.workers import worker as module
from perfbound.workers.worker import Heartbeats, WorkerProcess
from tests.unit.workers.test_ends import Wire


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        """Return its time."""
        return self.now


class Fixture:
    """The heartbeats of a worker that asks every half second."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wire, self.clock = Wire(), Clock()
        monkeypatch.setattr(module, "time", self.clock)
        self.seen = [("first", "run")]
        monkeypatch.setattr(self.wire, "orchestrators", lambda: self.seen)
        self.heartbeats = Heartbeats(self.wire, HEARTBEAT)

    def times(self, seconds: float, early: float = 0.0) -> list[float]:
        """Return the times of the heartbeats of the next seconds, each asked for `early` s too soon."""
        begin, found = self.clock.now, list[float]()
        for number in range(int(seconds / HEARTBEAT)):
            self.clock.now = begin + number * HEARTBEAT - early
            found += [begin + number * HEARTBEAT] if self.heartbeats.due(at_once=False) else []
        self.clock.now = begin + seconds
        return found


@pytest.fixture
def worker(monkeypatch: pytest.MonkeyPatch) -> Fixture:
    return Fixture(monkeypatch)


@pytest.mark.parametrize("early", [0.0, 0.01])
def test_a_worker_that_was_told_nothing_has_the_interval_of_before(worker: Fixture, early: float) -> None:
    """An orchestrator of a build without the message finds the same workers as ever."""
    assert worker.times(2.0, early) == [0.0, 0.5, 1.0, 1.5]


def test_the_interval_that_was_told_counts_from_the_next_heartbeat(worker: Fixture) -> None:
    assert worker.times(0.5) == [0.0]
    worker.heartbeats.interval = 2.0
    assert worker.times(8.0) == [0.5, 2.5, 4.5, 6.5]
    assert worker.times(1.0) == [8.5]
    assert worker.heartbeats.due(at_once=True), "a change is sent at once"
    assert worker.times(6.0) == [11.5, 13.5], "and the interval begins anew"


def test_a_new_orchestrator_gets_a_heartbeat_at_once_and_the_interval_of_before(worker: Fixture) -> None:
    assert worker.times(0.5) == [0.0]
    worker.heartbeats.interval = 60.0
    assert worker.times(10.0) == [0.5]
    worker.seen = [("second", "run")]
    assert worker.times(2.0) == [10.5, 11.0, 11.5, 12.0]


def test_after_a_link_that_was_down_the_interval_is_that_of_before(worker: Fixture) -> None:
    worker.times(0.5)
    worker.heartbeats.interval = 60.0
    worker.times(10.0)
    seen, worker.seen = worker.seen, []
    worker.times(10.0)
    worker.seen = seen
    assert worker.times(1.5) == [20.5, 21.0, 21.5]


def test_a_worker_takes_the_interval_that_it_is_told() -> None:
    worker = WorkerProcess("w", Wire())
    assert worker._heartbeats.interval == HEARTBEAT
    worker.receive(HeartbeatInterval(seconds=4.0))
    assert worker._heartbeats.interval == 4.0
