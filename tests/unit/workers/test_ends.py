"""When a worker ends by itself, and when it leaves a run: the decisions, and what a leaving worker sends."""

import threading
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import pytest

from perfbound.schemas.errors import SimulationError
from perfbound.schemas.link.messages import (
    Ack,
    Assign,
    Cancel,
    HeartbeatInterval,
    Release,
    Request,
    ResultHeader,
    RunFinished,
    WorkerState,
)
from perfbound.workers import worker as module
from perfbound.workers.ends import (
    IDLE_EXIT,
    LINK_GRACE,
    OUTBOX_KEPT,
    RUN_GONE,
    EndOptions,
    gone_since,
    is_abandoned,
)
from perfbound.workers.worker import EndOfRun, WorkerProcess
from tests.patience import PATIENCE
from tests.unit.run.test_service import an_assign

FOREVER: Callable[[bool], bool] = lambda _: False  # noqa: E731


def options(*, until_done: bool = False, idle_exit: float | None = None, max_hours: float | None = None) -> EndOptions:
    return EndOptions.of(until_done=until_done, idle_exit=idle_exit, max_hours=max_hours, stop_within=25.0)


def test_only_a_worker_that_is_told_to_ends_by_itself() -> None:
    plain = options()
    assert not plain.is_idle_for_too_long(1e9)
    assert not plain.is_over(1e9)
    patient = options(until_done=True)
    assert (patient.is_idle_for_too_long(IDLE_EXIT - 1), patient.is_idle_for_too_long(IDLE_EXIT)) == (False, True)
    given = options(until_done=True, idle_exit=7.0)
    assert (given.is_idle_for_too_long(6.9), given.is_idle_for_too_long(7.0)) == (False, True)
    hours = options(max_hours=0.5)
    assert (hours.is_over(1799.0), hours.is_over(1800.0)) == (False, True)


def left_after(looks: list[tuple[float, bool, bool]]) -> float | None:
    """Return when an idle worker leaves a run that it saw at (time, present, linked)."""
    gone = looks[0][0]
    for now, present, linked in looks:
        gone = gone_since(gone, now, present=present, linked=linked)
        if is_abandoned(now - gone, outbox_empty=True):
            return now
    return None


def seconds(first: int, last: int, *, present: bool, linked: bool) -> list[tuple[float, bool, bool]]:
    return [(float(now), present, linked) for now in range(first, last)]


def test_a_run_is_left_when_its_orchestrator_is_gone() -> None:
    seen = seconds(0, 100, present=True, linked=True)
    assert left_after(seen + seconds(100, 200, present=False, linked=True)) == 99 + RUN_GONE + 1
    # A result that is not delivered keeps the worker for longer.
    assert not is_abandoned(OUTBOX_KEPT, outbox_empty=False)
    assert is_abandoned(OUTBOX_KEPT + 1, outbox_empty=False)


def test_without_a_link_to_its_router_a_worker_stays_and_later_waits_for_the_orchestrator_behind_it() -> None:
    seen, down = seconds(0, 10, present=True, linked=True), seconds(10, 500, present=False, linked=False)
    assert left_after(seen + down) is None
    back = seconds(500, 600, present=False, linked=True)
    assert left_after(seen + down + back) == 499 + LINK_GRACE + RUN_GONE + 1
    in_time = seconds(500, 530, present=False, linked=True) + seconds(530, 900, present=True, linked=True)
    assert left_after(seen + down + in_time) is None


class Wire:
    """An uplink that keeps what a worker sends; `answers` turns results and heartbeats into requests."""

    def __init__(self) -> None:
        self.results: list[ResultHeader] = []
        self.states: list[WorkerState] = []

    def orchestrators(self) -> list[tuple[str, str]]:
        """None."""
        return []

    def join(self, run: str, worker: str, receive: Callable[[Request], None]) -> None:
        """Nothing."""

    def leave(self) -> None:
        """Nothing."""

    def report(self, state: WorkerState) -> None:
        """Keep a heartbeat."""
        self.states.append(state)

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Keep a result."""
        self.results.append(header)

    def shows(self, condition: Callable[[WorkerState], object]) -> bool:
        """Whether there is a heartbeat, and the last one meets a condition."""
        return bool(self.states) and bool(condition(self.states[-1]))


class Running:
    """A worker in a thread, and how it ended."""

    def __init__(self, wire: Wire) -> None:
        self.worker = WorkerProcess("w", wire)
        self.end: EndOfRun | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        self.end = self.worker.serve(FOREVER)

    def ended(self) -> EndOfRun | None:
        self._thread.join(PATIENCE)
        return self.end


def acknowledged(worker: WorkerProcess, assign: Assign) -> None:
    worker.receive(Ack(rollout=assign.request.rollout, attempt=assign.attempt))


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Rollouts that only end when they are cancelled; the event says that one has begun."""
    begun = threading.Event()

    def endless(_system: object, _request: object, progress: Callable[[int], None]) -> bytes:
        begun.set()
        while True:
            progress(1)
            time.sleep(0.002)

    monkeypatch.setattr(module, "run_on", endless)
    monkeypatch.setattr(module, "requested_system", lambda _: None)
    return begun


def test_the_end_of_a_run_ends_a_rollout_under_way() -> None:
    wire = Wire()
    running = Running(wire)
    running.worker.receive(RunFinished())
    assert running.ended() == "finished"


@pytest.mark.integration
def test_a_busy_worker_ends_with_its_run_and_delivers_nothing(begun: threading.Event) -> None:
    wire = Wire()
    running = Running(wire)
    running.worker.receive(an_assign(0))
    assert begun.wait(PATIENCE)
    running.worker.receive(RunFinished())
    assert (running.ended(), wire.results) == ("finished", [])


@pytest.mark.integration
def test_an_attempt_begins_and_ends_with_a_heartbeat_whatever_the_interval(begun: threading.Event) -> None:
    """An assignment that no heartbeat confirms is sent again, and an idle worker waits for none."""
    wire = Wire()
    running = Running(wire)
    running.worker.receive(HeartbeatInterval(seconds=600.0))
    until(lambda: wire.states)
    running.worker.receive(assign := an_assign(0))
    assert begun.wait(PATIENCE)
    until(lambda: wire.shows(lambda state: state.attempt == assign.attempt))
    running.worker.receive(Cancel(rollout=assign.request.rollout, attempt=assign.attempt))
    until(lambda: wire.shows(lambda state: state.state == "idle"))
    running.worker.leave()
    until(lambda: wire.shows(lambda state: state.leaving))
    running.worker.receive(Release())


@pytest.mark.integration
def test_short_rollouts_have_no_heartbeats_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two for each cost the orchestrator as much as its result."""
    monkeypatch.setattr(module, "run_on", lambda *_: b"")
    monkeypatch.setattr(module, "requested_system", lambda _: SimpleNamespace(spec=None))
    monkeypatch.setattr(module, "largest_result", lambda *_: 1)
    monkeypatch.setattr(module, "HEARTBEAT", PATIENCE)
    wire = Wire()
    running = Running(wire)
    until(lambda: wire.states)
    for test in range(20):
        running.worker.receive(an_assign(test))
        until(partial(lambda before: len(wire.results) > before, test))
    assert len(wire.states) == 1
    running.worker.receive(RunFinished())


@pytest.mark.integration
def test_a_worker_that_leaves_waits_for_its_dismissal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DISMISSAL", 2 * PATIENCE)
    wire = Wire()
    running = Running(wire)
    running.worker.leave()
    until(lambda: wire.shows(lambda state: state.leaving))
    assert not running.worker.has_left
    # An assignment that crosses its farewell comes back, with no time lost.
    running.worker.receive(assign := an_assign(0))
    until(lambda: wire.results)
    assert {(each.outcome, each.kind) for each in wire.results} == {("handed_back", None)}
    running.worker.receive(Release())
    assert not running.worker.has_left, "what it hands back is not acknowledged"
    acknowledged(running.worker, assign)
    assert running.ended() == "left"


def test_without_an_orchestrator_a_worker_leaves_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DISMISSAL", 0.05)
    running = Running(Wire())
    running.worker.leave()
    assert running.ended() == "left"


@pytest.mark.integration
@pytest.mark.parametrize("by_signal", [True, False])
def test_what_fails_as_the_signal_comes_is_handed_back(monkeypatch: pytest.MonkeyPatch, *, by_signal: bool) -> None:
    """A scheduler sends it to every process of a job, also to the programs of a system."""
    begun, ends = threading.Event(), threading.Event()

    def failing(*_: object) -> bytes:
        begun.set()
        ends.wait(PATIENCE)
        raise SimulationError("pendulum was ended by SIGTERM")

    monkeypatch.setattr(module, "run_on", failing)
    monkeypatch.setattr(module, "requested_system", lambda _: None)
    wire = Wire()
    running = Running(wire)
    running.worker.receive(assign := an_assign(0))
    assert begun.wait(PATIENCE)
    ends.set()
    running.worker.leave(by_signal=by_signal)
    until(lambda: wire.results)
    acknowledged(running.worker, assign)
    running.worker.receive(Release())
    assert running.ended() == "left"
    assert {each.outcome for each in wire.results} == {"handed_back" if by_signal else "failed"}


@pytest.mark.integration
def test_a_rollout_is_handed_back_once_and_its_result_is_dropped(begun: threading.Event) -> None:
    wire = Wire()
    running = Running(wire)
    running.worker.receive(assign := an_assign(0))
    assert begun.wait(PATIENCE)
    running.worker.leave()
    running.worker.hand_back()
    running.worker.hand_back()
    until(lambda: wire.shows(lambda state: state.state == "idle" and state.leaving))
    acknowledged(running.worker, assign)
    running.worker.receive(Release())
    assert running.ended() == "left"
    assert {each.outcome for each in wire.results} == {"handed_back"}


def test_a_result_has_the_seconds_that_its_rollout_took(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(cpu=100.0, wall=1000.0)

    def simulated(*_: object) -> bytes:
        clock.cpu, clock.wall = clock.cpu + 2.0, clock.wall + 3.0
        return b"x"

    monkeypatch.setattr(module, "time", SimpleNamespace(process_time=lambda: clock.cpu, monotonic=lambda: clock.wall))
    monkeypatch.setattr(module, "run_on", simulated)
    monkeypatch.setattr(module, "requested_system", lambda _: SimpleNamespace(spec=SimpleNamespace(largest_file=10)))
    wire = Wire()
    worker = WorkerProcess("w", wire)
    worker.receive(an_assign(0))
    worker.serve(lambda _: bool(wire.results))
    assert {(each.cpu_seconds, each.wall_seconds) for each in wire.results} == {(2.0, 3.0)}
