"""A campaign with the heartbeat interval of a large fleet: same certificate, and a hung worker is found in its time."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.link import messages
from perfbound.schemas.link.messages import HeartbeatInterval, Request, ResultHeader, WorkerState
from perfbound.workers.transport import Receiver
from tests.fakes.inmemory import InMemoryUplink, campaign, hurry
from tests.unit.run.test_service import a_config

HUNG_AFTER = 3.0
CONFIG = a_config(max_tests=4, replicates=2, hung_after=HUNG_AFTER)
LONGER = a_config(max_tests=60, replicates=2, hung_after=HUNG_AFTER)
"""Enough for both workers: a shorter campaign may end before the second one has joined it."""


@pytest.fixture(autouse=True)
def large_fleet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two workers are as many as the longest interval needs."""
    hurry(monkeypatch, tick=0.02)
    monkeypatch.setattr(messages, "MOST", 1)


class Watched:
    """What an uplink gets and sends; a `hung` worker is busy for ever, and a `former` one knows no intervals."""

    def __init__(self, *, hung: bool = False, former: bool = False) -> None:
        self.intervals: list[float] = []
        self._hung, self._former = hung, former
        self._busy: WorkerState | None = None

    def __call__(self, uplink: InMemoryUplink) -> InMemoryUplink:
        """Return the uplink, watched."""
        join, report, deliver = uplink.join, uplink.report, uplink.deliver
        uplink.join = lambda run, worker, receive: join(run, worker, self._receiver(receive))  # type: ignore[method-assign]
        uplink.report = lambda state: self._report(state, report)  # type: ignore[method-assign]
        uplink.deliver = lambda header, payload: self._deliver(header, payload, deliver)  # type: ignore[method-assign]
        return uplink

    def _receiver(self, receive: Receiver) -> Receiver:
        def take(message: Request) -> None:
            if isinstance(message, HeartbeatInterval):
                self.intervals.append(message.seconds)
                if self._former:
                    return
            receive(message)

        return take

    def _report(self, state: WorkerState, report: Callable[[WorkerState], None]) -> None:
        if self._hung:
            self._busy = self._busy or (state if state.state == "busy" else None)
        report(self._busy or state)

    def _deliver(self, header: ResultHeader, payload: bytes, deliver: Callable[[ResultHeader, bytes], None]) -> None:
        if not self._hung:
            deliver(header, payload)


def failures(directory: Path) -> list[tuple[str, float]]:
    """Return why attempts failed, and after how many seconds."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute(
            "SELECT outcome, ended - started FROM outcomes JOIN attempts USING (rollout, attempt) "
            "WHERE outcome <> 'recorded'"
        ).fetchall()


def test_the_fleet_is_told_and_the_certificate_is_that_of_any_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where one worker is of a build that does not know the message."""
    watched, former = Watched(), Watched(former=True)
    expected = campaign(tmp_path / "run", LONGER, workers=0, wraps=[watched, former])
    assert set(watched.intervals) == set(former.intervals) == {1.0}
    assert failures(tmp_path / "run") == []
    monkeypatch.setattr(messages, "MOST", 250)
    small = Watched()
    assert campaign(tmp_path / "small", LONGER, workers=0, wraps=[small]) == expected
    assert small.intervals == []


def test_a_hung_worker_is_found_in_its_time(tmp_path: Path) -> None:
    hung = Watched(hung=True)
    campaign(tmp_path / "run", CONFIG, workers=1, wraps=[hung])
    assert set(hung.intervals) == {1.0}
    found = failures(tmp_path / "run")
    assert {reason for reason, _ in found} == {f"no progress for {HUNG_AFTER:g} s"}
    assert all(seconds > 0.9 * HUNG_AFTER for _, seconds in found)
