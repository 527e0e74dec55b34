"""Workers that have one of two simulators: each rollout goes to one that has its own."""

from perfbound.orchestrator.fleet.dispatch import machine
from perfbound.orchestrator.fleet.dispatch.choice import is_alone
from perfbound.orchestrator.fleet.dispatch.events import (
    Action,
    Delivered,
    Event,
    HandOut,
    Reported,
    Start,
    Tick,
    Wanted,
    WorkerDown,
    WorkerUp,
)
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, FileId, RolloutId
from tests.fakes.invariants import check_invariants

NOMINAL, TRUE = frozenset({"nominal"}), frozenset({"true"})
N0, N1 = (RolloutId("p", test, "nominal", 0) for test in range(2))
T0, T1 = (RolloutId("p", test, "true", 0) for test in range(2))


def play(state: DispatchState, *events: Event) -> tuple[DispatchState, list[tuple[str, object]]]:
    """Take events, each with a hand-out behind it; return who got what."""
    found: list[Action] = []
    for event in events:
        for each in (event, HandOut(event.at)):
            state, actions = machine.advance(state, each)
            check_invariants(state)
            found += actions
    return state, [(each.worker, each.attempt.rollout) for each in found if isinstance(each, Start)]


def up(at: float, name: str, variants: frozenset[str] | None = None) -> list[Event]:
    return [WorkerUp(at, name, name, variants), Reported(at, name, None, 0)]


def wanted(*rollouts: RolloutId | FileId) -> Wanted:
    return Wanted(0.0, tuple((each, 0) for each in rollouts))


def test_each_rollout_goes_to_a_worker_with_its_simulator() -> None:
    workers = [*up(0.0, "a", NOMINAL), *up(0.0, "b", TRUE), *up(0.0, "c")]
    _, found = play(DispatchState(Limits()), *workers, wanted(T0, T1, N0, N1))
    assert found == [("b", T0), ("c", T1), ("a", N0)]


def test_one_without_a_worker_waits_and_stops_no_other() -> None:
    state, found = play(DispatchState(Limits()), *up(0.0, "a", NOMINAL), wanted(T0, N0, N1))
    assert found == [("a", N0)]
    state, found = play(state, Delivered(1.0, "a", Attempt(N0, 1), None, "x"), Tick(50.0))
    assert found == [("a", N1)]
    state, found = play(state, *up(60.0, "b", TRUE))
    assert found == [("b", T0)]


def test_a_batch_goes_by_its_variant() -> None:
    batch = FileId(T0, 8)
    state, found = play(DispatchState(Limits()), *up(0.0, "a", NOMINAL), wanted(batch))
    assert found == []
    assert play(state, *up(1.0, "b", TRUE))[1] == [("b", batch)]


def test_a_failure_is_not_tried_by_one_that_has_another_simulator() -> None:
    raised = Failure("system", "it raised")
    state, _ = play(DispatchState(Limits()), *up(0.0, "a", NOMINAL), *up(0.0, "b", TRUE), wanted(T0))
    state, found = play(state, Delivered(1.0, "b", Attempt(T0, 1), raised))
    assert is_alone(state, T0, 100.0)
    state, more = play(state, *up(2.0, "c", TRUE), Tick(100.0))
    assert {name for name, _ in found + more} <= {"b", "c"}
    assert "c" in {name for name, _ in more}


def test_a_worker_that_returns_with_more_gets_more() -> None:
    state, _ = play(DispatchState(Limits()), *up(0.0, "a", NOMINAL), wanted(T0))
    state, _ = play(state, WorkerDown(1.0, "a"), Tick(1000.0))
    assert not state.variants, "nothing is kept of a worker that is lost"
    assert play(state, *up(1001.0, "a"))[1] == [("a", T0)]
