"""Results that a worker keeps: when they are delivered again."""

import pytest

from perfbound.schemas.link.messages import Assign, ResultHeader, WorkerState
from perfbound.workers.parcels import LONGEST_WAIT, Parcels
from perfbound.workers.transport import Receiver
from tests.unit.fleet.link.test_fuzz_border import REQUEST


class Way:
    """An uplink that writes down when something is delivered."""

    def __init__(self) -> None:
        self.now = 0.0
        self.announced = [("first", "run")]
        self.delivered: list[float] = []

    def orchestrators(self) -> list[tuple[str, str]]:
        return list(self.announced)

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        self.delivered.append(self.now)

    def join(self, run: str, worker: str, receive: Receiver) -> None: ...
    def leave(self) -> None: ...
    def report(self, state: WorkerState) -> None: ...


def delivered(way: Way, found: Parcels, until: float) -> list[float]:
    """Return the times of deliveries, with a heartbeat every half second."""
    while way.now < until:
        found.deliver(1.0)
        way.now += 0.5
    return way.delivered


@pytest.fixture
def way(monkeypatch: pytest.MonkeyPatch) -> Way:
    way = Way()
    monkeypatch.setattr("perfbound.workers.parcels.time.monotonic", lambda: way.now)
    return way


def test_a_busy_orchestrator_gets_a_result_less_and_less_often(way: Way) -> None:
    found = Parcels("w", way)
    found.add(Assign(attempt=1, secret="0" * 64, request=REQUEST), b"file")
    assert delivered(way, found, 50) == [0, 1, 3, 7, 15, 31, 47]
    assert way.delivered[-1] - way.delivered[-2] == LONGEST_WAIT


def test_an_orchestrator_that_is_announced_anew_gets_it_soon(way: Way) -> None:
    found = Parcels("w", way)
    found.add(Assign(attempt=1, secret="0" * 64, request=REQUEST), b"file")
    delivered(way, found, 20)
    way.announced = []
    delivered(way, found, 22)
    way.announced, way.delivered = [("second", "run")], []
    assert delivered(way, found, 30)[0] <= 22 + 1
    assert len(way.delivered) == 3
