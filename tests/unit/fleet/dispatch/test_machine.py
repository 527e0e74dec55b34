"""The dispatch core: its table, its rules one by one, and a simulated world that loses, delays and repeats all."""

import heapq
import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.fleet.dispatch import machine
from perfbound.orchestrator.fleet.dispatch.events import (
    Acknowledge,
    Action,
    AwaitOther,
    Delivered,
    Dismiss,
    Event,
    Fail,
    GiveUp,
    HandedBack,
    HandOut,
    LinkChanged,
    OftenHandedBack,
    Poison,
    Record,
    Reported,
    Requeue,
    Resend,
    Revoke,
    RouterChanged,
    SetAside,
    Start,
    TakeBack,
    Tick,
    Unwanted,
    Wanted,
    WorkerDown,
    WorkerUp,
)
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.machine import KNOWN, LEGAL, OFTEN, SIDE_EFFECTS
from perfbound.orchestrator.fleet.dispatch.retries import blames_rollout, missed
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, FileId, RolloutId, WorkId
from perfbound.schemas.link.messages import heartbeat_interval
from tests.fakes.invariants import check_invariants

LIMITS = Limits(resend_after=1.5, lost_after=3.0, hung_after=10.0, deadline=60.0, max_attempts=3)
R = [RolloutId("p", test, "true", 0) for test in range(6)]


def step(state: DispatchState, event: Event) -> tuple[DispatchState, tuple[Action, ...]]:
    """A turn of the service with one message."""
    before = state
    state, actions = machine.advance(state, event)
    check_invariants(state)
    keeps_the_table(before, event, state)
    before = state
    state, starts = machine.advance(state, HandOut(event.at))
    check_invariants(state)
    given = [each for each in starts if not isinstance(each, AwaitOther)]
    assert all(isinstance(start, Start) and before.workers[start.worker].phase == "idle" for start in given)
    return state, (*actions, *starts)


def after(*events: Event, limits: Limits = LIMITS, hold_until: float = 0.0) -> tuple[DispatchState, list[Action]]:
    """The state after some events, and the actions of the last one."""
    state, actions = DispatchState(limits, hold_until), tuple[Action, ...]()
    for event in events:
        state, actions = step(state, event)
    return state, list(actions)


def want(*rollouts: RolloutId, at: float = 0.0, attempts: int = 0) -> Wanted:
    return Wanted(at, tuple((rollout, attempts) for rollout in rollouts))


def idle(worker: str = "w", at: float = 0.0) -> Reported:
    return Reported(at, worker, None, 0)


def busy(rollout: RolloutId, number: int = 1, *, worker: str = "w", at: float = 0.0, progress: int = 0) -> Reported:
    return Reported(at, worker, Attempt(rollout, number), progress)


SLOW_BATCH = Limits(deadline=10.0)
BAD, RAISED = Failure("infrastructure", "bad"), Failure("system", "the solver did not converge")


def done(
    rollout: RolloutId, number: int = 1, *, worker: str = "w", at: float = 0.0, failure: Failure | None = None
) -> Delivered:
    return Delivered(at, worker, Attempt(rollout, number), failure)


def up(worker: str = "w", at: float = 0.0) -> tuple[Event, Event]:
    return WorkerUp(at, worker), idle(worker, at)


def first(rollout: RolloutId, number: int = 1) -> Attempt:
    return Attempt(rollout, number)


def test_a_batch_may_take_the_deadline_for_each_of_its_rollouts() -> None:
    batch = FileId(R[0], 16)
    wanted = Wanted(0.0, ((batch, 0),))
    attempt = Attempt(batch, 1)
    for at in (9.0, 159.0):
        state, actions = after(*up(), wanted, Reported(at, "w", attempt, int(at)), Tick(at), limits=SLOW_BATCH)
        assert actions == [], at
        assert state.workers["w"].attempt == attempt
    _, actions = after(*up(), wanted, Reported(160.0, "w", attempt, 9), Tick(160.0), limits=SLOW_BATCH)
    (failed,) = (each for each in actions if isinstance(each, Fail))
    assert failed.failure == missed(10.0, 16)
    assert blames_rollout(failed.failure, 10.0)


# The table

WORKER = ("WorkerUp", "WorkerDown", "Reported", "Delivered", "HandedBack", "Tick")


def printed_table() -> dict[tuple[str, str], str]:
    assert machine.__doc__ is not None
    lines = [line.split("  ") for line in machine.__doc__.splitlines() if line.startswith("    ")]
    rows = [[cell.strip() for cell in line if cell.strip()] for line in lines]
    assert tuple(rows[0][1:]) == WORKER
    return {(row[0], name): cell for row in rows[1:] for name, cell in zip(WORKER, row[1:], strict=True)}


TABLE = printed_table()
TRANSITIONS: dict[tuple[str, str], tuple[str, ...]] = {(phase, event): after for (phase, event), after in LEGAL.items()}
OTHERS: dict[tuple[str, str], tuple[str, ...]] = {
    (phase, event): after for (phase, event), after in SIDE_EFFECTS.items()
}


def test_the_printed_table_is_the_data() -> None:
    for (phase, event), cell in TABLE.items():
        after = {"-": None, "(ignored)": (phase,), "(back)": KNOWN}.get(cell, tuple(cell.split(", ")))
        assert TRANSITIONS.get((phase, event)) == after, (phase, event)
    assert {key for key in TRANSITIONS if key[1] != "HandOut"} <= set(TABLE)


def keeps_the_table(before: DispatchState, event: Event, state: DispatchState) -> None:
    """Assert that every worker went where the table allows."""
    for name in {*before.workers, *state.workers}:
        worker, now = before.workers.get(name), state.workers.get(name)
        old, new = worker.phase if worker else "unknown", now.phase if now else "unknown"
        kind = type(event).__name__
        named = isinstance(event, Tick) or getattr(event, "worker", None) == name
        allowed = set(TRANSITIONS.get((old, kind), (old,))) if named else {old, *OTHERS.get((old, kind), ())}
        if (old, kind) == ("gone", "WorkerUp"):
            assert worker is not None
            allowed &= {str(worker.resumes_as), "gone"}
        if named and kind == "Delivered":
            allowed |= set(OTHERS.get((old, kind), ()))  # its own result came from an earlier attempt
        assert new in allowed, f"{name}: {old} -> {new} at {event}"
        if TABLE.get((old, kind)) == "(ignored)" and named:
            assert now == worker


BEFORE: dict[str, list[Event]] = {
    "unknown": [],
    "new": [WorkerUp(0, "w")],
    "idle": [*up()],
    "sent": [*up(), want(R[0])],
    "busy": [*up(), want(R[0]), busy(R[0])],
    "shunned": [*up(), want(R[0]), Unwanted(0, (R[0],))],
    "gone": [*up(), WorkerDown(0, "w")],
}
VARIANTS: dict[str, list[Event]] = {
    "WorkerUp": [WorkerUp(1, "w")],
    "WorkerDown": [WorkerDown(1, "w")],
    "HandedBack": [HandedBack(1, "w", first(R[0])), HandedBack(1, "w", first(R[5]))],
    "Reported": [
        idle(at=1),
        Reported(1, "w", None, 0, leaving=True),
        busy(R[0], at=1, progress=1),
        busy(R[5], at=1),
        busy(R[0], 2, at=1),
    ],
    "Delivered": [done(R[0], at=1), done(R[5], at=1), done(R[0], at=1, failure=BAD)],
    "Tick": [Tick(1), Tick(5), Tick(10), Tick(70)],
}


@pytest.mark.parametrize("phase", BEFORE)
@pytest.mark.parametrize("name", WORKER)
def test_every_cell_of_the_table(phase: str, name: str) -> None:
    reached = set()
    # Only what waits and was given can be adopted.
    waiting: list[list[Event]] = [[], [want(R[0], attempts=1)]] if phase == "new" else [[]]
    for event, more in itertools.product(VARIANTS[name], waiting):
        state, _ = after(*BEFORE[phase], *more)
        assert (state.workers["w"].phase if "w" in state.workers else "unknown") == phase
        now, actions = machine.advance(state, event)
        check_invariants(now)
        keeps_the_table(state, event, now)
        reached.add(now.workers["w"].phase if "w" in now.workers else "unknown")
        if TABLE[phase, name] == "(ignored)":
            assert now == state
            assert actions == () or name == "Delivered"
    cell = TABLE[phase, name]
    if cell in ("-", "(ignored)"):
        assert reached == {phase}
    elif cell == "(back)":
        assert reached == {"idle"}
    else:
        assert reached == set(cell.split(", ")), "every phase is reached"


# The rules


def test_a_waiting_rollout_goes_to_an_idle_worker_in_order() -> None:
    state, actions = after(*up("b"), *up("a"), want(R[1], R[0], R[2]))
    assert actions == [Start("a", first(R[1])), Start("b", first(R[0]))]
    assert state.waiting == (R[2],)


def test_nothing_is_wanted_twice() -> None:
    state, _ = after(want(R[0]), want(R[0]), *up(), want(R[0]))
    assert (state.waiting, len(state.open)) == ((), 1)


def test_a_new_worker_gets_nothing_before_it_says_what_it_does() -> None:
    _, actions = after(want(R[0]), WorkerUp(0, "w"))
    assert actions == []
    _, actions = after(want(R[0]), WorkerUp(0, "w"), busy(R[5]))
    assert actions == [Revoke("w", first(R[5]))]
    _, actions = after(want(R[0]), WorkerUp(0, "w"), idle())
    assert actions == [Start("w", first(R[0]))]


def test_a_worker_that_was_lost_goes_on_with_what_it_has() -> None:
    lost = [*up(), want(R[0], R[1]), busy(R[0]), WorkerDown(1, "w"), Tick(4)]
    state, actions = after(*lost, WorkerUp(5, "w"), busy(R[0], at=5, progress=9))
    assert actions == []
    assert state.workers["w"].attempt == first(R[0])
    assert state.waiting == (R[1],)


def test_after_a_restart_busy_workers_are_adopted_and_numbers_go_on() -> None:
    restart: list[Event] = [want(R[0], attempts=2), WorkerUp(0, "w"), busy(R[0], 2)]
    state, actions = after(*restart, *up("v"), hold_until=2.5)
    assert (actions, state.workers["w"].phase, state.workers["v"].phase) == ([], "busy", "idle")
    state, actions = after(*restart, done(R[0], 2, failure=BAD), Tick(2.5), hold_until=2.5)
    assert actions == [Start("w", first(R[0], 3))]


def test_an_attempt_that_nobody_made_is_not_adopted_and_pushes_no_number() -> None:
    for claimed in (4, 999_999, 1_000_000):
        report: list[Event] = [want(R[0], attempts=3), WorkerUp(0, "w"), busy(R[0], claimed)]
        state, actions = after(*report)
        assert (actions, state.workers["w"].phase) == ([Revoke("w", first(R[0], claimed))], "new")
        assert after(*report, idle(at=1))[1] == [Start("w", first(R[0], 4))]


def test_nothing_is_assigned_during_the_hold() -> None:
    state, actions = after(want(R[0]), *up(), Tick(2.4), hold_until=2.5)
    assert actions == []
    assert step(state, Tick(2.5))[1] == (Start("w", first(R[0])),)


def test_a_lost_assignment_is_sent_again() -> None:
    sent: list[Event] = [*up(), want(R[0])]
    assert after(*sent, Tick(1.4))[1] == []
    assert after(*sent, Tick(1.5))[1] == [Resend("w", first(R[0]))]
    assert after(*sent, Tick(1.5), Tick(2.9))[1] == []
    assert after(*sent, Tick(1.5), Tick(3.0))[1] == [Resend("w", first(R[0]))]
    assert after(*sent, busy(R[0], at=1), Tick(5))[1] == []


def test_a_valid_result_is_recorded_once_and_acknowledged_always() -> None:
    taken: list[Event] = [*up(), want(R[0]), done(R[0])]
    state, actions = after(*taken)
    assert actions == [Record("w", first(R[0])), Acknowledge("w", first(R[0]))]
    assert (state.open, state.workers["w"].phase) == ({}, "idle")
    assert after(*taken, done(R[0]))[1] == [Acknowledge("w", first(R[0]))]
    assert after(done(R[0], worker="stranger"))[1] == [Acknowledge("stranger", first(R[0]))]


def test_the_first_valid_result_wins_and_the_other_worker_is_cancelled() -> None:
    history = [*up("a"), want(R[0]), busy(R[0], worker="a"), WorkerDown(1, "a"), Tick(4), *up("b", 4)]
    state, actions = after(*history, done(R[0], worker="a", at=5))
    assert actions == [Record("a", first(R[0])), Acknowledge("a", first(R[0])), Revoke("b", first(R[0], 2))]
    assert state.workers["b"].phase == "shunned"
    assert step(state, idle("b", 6))[0].workers["b"].phase == "idle"


def handed_back(rollout: RolloutId, number: int = 1, *, worker: str = "w", at: float = 1.0) -> HandedBack:
    return HandedBack(at, worker, Attempt(rollout, number))


def leaving(worker: str = "w", at: float = 1.0) -> Reported:
    return Reported(at, worker, None, 0, leaving=True)


def test_what_is_handed_back_goes_to_another_worker_at_once_and_counts_against_nobody() -> None:
    history: list[Event] = [*up("a"), want(R[0], R[1]), busy(R[0], worker="a"), *up("b"), busy(R[1], worker="b")]
    state, actions = after(*history, *up("c"), handed_back(R[0], worker="a"))
    first_try, second = first(R[0]), first(R[0], 2)
    assert actions == [Requeue("a", first_try), Acknowledge("a", first_try), Start("c", second)]
    assert (state.standings, state.open[R[0]].failures, state.workers["a"].phase) == ({}, (), "shunned")


def test_handing_back_never_poisons_a_rollout_and_never_sets_a_worker_aside() -> None:
    events: list[Event] = [want(R[0])]
    for number in range(1, 4 * LIMITS.max_attempts):
        name = f"w{number}"
        events += [*up(name, number), handed_back(R[0], number, worker=name, at=number), leaving(name, number)]
        events += [WorkerDown(number, name)]
    state, actions = after(*events, *up("last", 100))
    assert actions == [Start("last", first(R[0], 4 * LIMITS.max_attempts))]
    assert (state.standings, state.open[R[0]].failures) == ({}, ())


def test_a_rollout_that_is_handed_back_again_and_again_is_reported_once() -> None:
    state, reports = after(want(R[0], R[1]))[0], []
    for number in range(1, 3 * OFTEN):
        name = f"w{number}"
        back = handed_back(R[0], number, worker=name, at=number)
        # The second one is a repeat, because the acknowledgement was lost.
        for event in (*up(name, number), back, back, leaving(name, number), WorkerDown(number, name)):
            state, actions = step(state, event)
            reports += [(number, each) for each in actions if isinstance(each, OftenHandedBack)]
    assert reports == [(OFTEN, OftenHandedBack(R[0], OFTEN, f"w{OFTEN}", ""))]
    assert R[0] in state.waiting, "the campaign continues"


def test_hand_backs_before_a_restart_count() -> None:
    again = Wanted(0.0, ((R[0], OFTEN - 1),), handed_back={R[0]: OFTEN - 1})
    state, _ = after(again, *up("w", 1))
    _, actions = step(state, handed_back(R[0], OFTEN, worker="w", at=2))
    assert [each for each in actions if isinstance(each, OftenHandedBack)] == [OftenHandedBack(R[0], OFTEN, "w", "")]


def test_a_repeated_hand_back_is_acknowledged_and_starts_nothing_twice() -> None:
    history: list[Event] = [*up("a"), want(R[0]), busy(R[0], worker="a"), *up("b"), handed_back(R[0], worker="a")]
    state, actions = after(*history, *up("c"), handed_back(R[0], worker="a"))
    assert actions == [Requeue("a", first(R[0])), Acknowledge("a", first(R[0]))]
    assert state.workers["b"].attempt == first(R[0], 2)
    # Of a rollout that is recorded meanwhile, nothing is written.
    state, actions = after(*history, done(R[0], 2, worker="b"), handed_back(R[0], worker="a"))
    assert actions == [Acknowledge("a", first(R[0]))]


def test_a_worker_that_leaves_gets_nothing_more_and_is_dismissed() -> None:
    state, actions = after(*up(), leaving(), want(R[0]))
    assert (actions, state.waiting) == ([], (R[0],))
    assert step(state, leaving(at=2))[1] == (Dismiss("w"),), "each time: a message may be lost"
    assert after(WorkerUp(0, "w"), leaving(), want(R[0]))[0].waiting == (R[0],)


def test_a_worker_with_an_assignment_on_the_way_is_not_dismissed() -> None:
    """It says that it leaves before it has received what it hands back then."""
    sent: list[Event] = [*up(), want(R[0]), leaving()]
    assert after(*sent)[1] == []
    assert after(*sent, handed_back(R[0]), leaving())[1] == [Dismiss("w")]


def test_a_worker_that_has_left_is_known_as_such_also_without_its_token() -> None:
    for last in (handed_back(R[0]), done(R[0])):
        state, _ = after(*up(), want(R[0]), busy(R[0]), last, leaving())
        assert state.workers["w"].leaving
        assert step(state, WorkerDown(2, "w"))[0].workers["w"].leaving
    assert not after(*up(), want(R[0]), busy(R[0]), WorkerDown(2, "w"))[0].workers["w"].leaving


def test_what_a_lost_worker_hands_back_changes_nothing_of_its_successor() -> None:
    lost: list[Event] = [*up("a"), want(R[0]), busy(R[0], worker="a"), WorkerDown(1, "a"), Tick(4), *up("b", 4)]
    state, actions = after(*lost, handed_back(R[0], worker="a", at=5))
    assert actions == [Requeue("a", first(R[0])), Acknowledge("a", first(R[0]))]
    assert state.workers["b"].attempt == first(R[0], 2)
    gone, _ = after(*lost[:5], handed_back(R[0], worker="a"))
    assert (gone.workers["a"].phase, gone.workers["a"].resumes_as, gone.waiting) == ("gone", "shunned", (R[0],))


def test_a_failed_attempt_is_tried_again_first() -> None:
    _, actions = after(*up(), want(R[0], R[1]), done(R[0], failure=BAD))
    assert actions == [Fail("w", first(R[0]), BAD), Acknowledge("w", first(R[0])), Start("w", first(R[0], 2))]


def test_a_repeated_failure_counts_once() -> None:
    """The acknowledgement was lost, so the worker reported its failure again, and had the next attempt already."""
    failed: list[Event] = [*up(), want(R[0]), done(R[0], failure=BAD)]
    state, actions = after(*failed, done(R[0], failure=BAD))
    assert actions == [Fail("w", first(R[0]), BAD), Acknowledge("w", first(R[0]))]
    assert len(state.open[R[0]].failures) == 1
    assert state.waiting == ()


def test_a_failure_of_the_system_is_recorded_even_when_the_rollout_is_closed() -> None:
    """Another attempt was recorded meanwhile: its outcome is one that a retry chose."""
    lost: list[Event] = [*up("a"), want(R[0]), busy(R[0], worker="a"), WorkerDown(1, "a"), Tick(4), *up("b", 4)]
    closed = [*lost, done(R[0], 2, worker="b", at=5)]
    _, actions = after(*closed, done(R[0], worker="a", at=6, failure=RAISED))
    assert actions == [Fail("a", first(R[0]), RAISED), Acknowledge("a", first(R[0]))]
    assert after(*closed, done(R[0], worker="a", at=6, failure=BAD))[1] == [Acknowledge("a", first(R[0]))]


def failed(number: int = 1, *, worker: str = "w", failure: Failure = RAISED) -> Delivered:
    return done(R[0], number, worker=worker, failure=failure)


def said(number: int, worker: str = "w", failure: Failure = RAISED) -> Fail:
    return Fail(worker, first(R[0], number), failure)


def test_two_workers_on_which_the_system_fails_alike_poison_a_rollout() -> None:
    history: list[Event] = [*up("a"), *up("b"), want(R[0]), failed(1, worker="a")]
    _, actions = after(*history)
    assert actions == [said(1, "a"), Acknowledge("a", first(R[0])), Start("b", first(R[0], 2))]
    state, actions = after(*history, failed(2, worker="b"))
    poison = Poison(R[0], (said(1, "a"), said(2, "b")))
    assert actions == [said(2, "b"), poison, Acknowledge("b", first(R[0], 2))]
    assert step(state, failed(2, worker="b"))[1] == (said(2, "b"), Acknowledge("b", first(R[0], 2))), "told once"
    assert Record("b", first(R[0], 2)) in step(state, done(R[0], 2, worker="b"))[1], "a late result is better than none"


def test_the_only_worker_tries_a_rollout_twice_and_the_second_time_afresh_where_it_can() -> None:
    history: list[Event] = [*up(), want(R[0]), failed(1)]
    state, actions = after(*history)
    # One of our own is killed, and a fresh one takes its place; to one elsewhere nothing happens.
    assert actions == [said(1), GiveUp("w"), Acknowledge("w", first(R[0])), Start("w", first(R[0], 2))]
    assert Poison(R[0], (said(1), said(2))) in step(state, failed(2))[1]
    killed, _ = machine.advance(after(*up(), want(R[0]))[0], failed(1))
    killed, done_next = step(killed, WorkerDown(0, "w"))
    assert done_next == (), "nothing is assigned to a worker that is about to be replaced"
    fresh, _ = step(killed, WorkerUp(1, "v"))
    fresh, done_next = step(fresh, idle("v", 1))
    assert done_next == (Start("v", first(R[0], 2)),)
    assert Poison(R[0], (said(1), said(2, "v"))) in step(fresh, failed(2, worker="v"))[1]


def test_twice_on_one_worker_is_not_enough_where_another_one_came() -> None:
    history: list[Event] = [*up("a"), want(R[0]), failed(1, worker="a"), *up("b"), failed(2, worker="a")]
    state, actions = after(*history, limits=replace(LIMITS, max_attempts=9))
    assert actions == [said(2, "a"), Acknowledge("a", first(R[0], 2)), Start("b", first(R[0], 3))]
    poison = Poison(R[0], (said(1, "a"), said(2, "a"), said(3, "b")))
    assert step(state, failed(3, worker="b"))[1][1] == poison


@pytest.mark.parametrize("second", [BAD, Failure("system", "another reason")])
def test_failures_that_differ_poison_only_as_many_as_are_allowed(second: Failure) -> None:
    history: list[Event] = [*up("a"), *up("b"), want(R[0]), failed(1, worker="a")]
    state, actions = after(*history, failed(2, worker="b", failure=second))
    retried = actions[-1]
    assert isinstance(retried, Start)
    assert not any(isinstance(action, Poison) for action in actions)
    third = Failure("system", "a third reason")
    told = (said(1, "a"), said(2, "b", second), said(3, retried.worker, third))
    assert Poison(R[0], told) in step(state, failed(3, worker=retried.worker, failure=third))[1]


def test_failures_of_the_infrastructure_poison_only_as_many_as_are_allowed() -> None:
    history: list[Event] = [*up(), want(R[0]), *(failed(number, failure=BAD) for number in (1, 2))]
    state, actions = after(*history)
    assert actions == [said(2, failure=BAD), Acknowledge("w", first(R[0], 2)), Start("w", first(R[0], 3))]
    told = tuple(said(number, failure=BAD) for number in (1, 2, 3))
    assert step(state, failed(3, failure=BAD))[1][1] == Poison(R[0], told)


@pytest.mark.parametrize("failure", [BAD, RAISED])
def test_another_idle_worker_comes_before_one_on_which_a_rollout_failed(failure: Failure) -> None:
    history: list[Event] = [*up("a"), want(R[0]), *up("b"), failed(1, worker="a", failure=failure)]
    _, actions = after(*history)
    assert actions[-1] == Start("b", first(R[0], 2))


@pytest.mark.parametrize("failure", [BAD, RAISED])
def test_a_rollout_waits_for_a_busy_worker_on_which_it_has_not_failed(failure: Failure) -> None:
    busy_elsewhere: list[Event] = [*up("a"), *up("b"), want(R[0], R[1]), want(R[2])]
    state, actions = after(*busy_elsewhere, failed(1, worker="a", failure=failure))
    assert actions[-1] == Start("a", first(R[2])), "meanwhile the idle one takes another rollout"
    assert state.waiting == (R[0],)
    assert step(state, done(R[1], worker="b"))[1][-1] == Start("b", first(R[0], 2))


@pytest.mark.parametrize(
    "leaves", [[Tick(10), done(R[1], 2, worker="a", at=11)], [WorkerDown(9, "b")]], ids=["hung", "gone"]
)
def test_after_a_failure_of_the_infrastructure_no_rollout_waits_for_a_worker_that_hangs_or_is_gone(
    leaves: list[Event],
) -> None:
    history: list[Event] = [*up("a"), *up("b"), want(R[0], R[1]), failed(1, worker="a", failure=BAD), idle("a", 9)]
    state, actions = after(*history)
    assert (actions, state.waiting) == ([], (R[0],))
    for event in leaves:
        state, more = step(state, event)
        actions += more
    assert Start("a", first(R[0], 2)) in actions


def test_a_recheck_goes_to_another_worker_while_one_serves() -> None:
    both: list[Event] = [*up("a"), *up("b"), want(R[1]), Wanted(0, ((R[0], 0),), {R[0]: "b"})]
    state, actions = after(*both)
    assert (actions, state.waiting) == ([], (R[0],)), "the idle one recorded the original"
    assert step(state, done(R[1], worker="a"))[1][-1] == Start("a", first(R[0]))
    assert Start("b", first(R[0])) in step(state, WorkerDown(1, "a"))[1]
    hung, retried = step(state, Tick(10))
    assert retried[-1] == Start("b", first(R[1], 2))
    assert step(hung, done(R[1], 2, worker="b"))[1][-1] == Start("b", first(R[0])), "it does not wait for ever"


def test_the_only_worker_repeats_its_rollouts_in_another_process() -> None:
    """What a process draws at its start it would repeat; a local worker is replaced, another one continues."""
    repeated = Wanted(0, ((R[0], 0), (R[1], 0)), {R[0]: "a", R[1]: "a"})
    state, found = after(*up("a"), repeated)
    assert found == [GiveUp("a"), Start("a", first(R[0]))]
    state, _ = step(state, WorkerDown(1, "a"))
    arrived, _ = step(state, up("b", 1.5)[0])
    assert Start("b", first(R[1])) in step(arrived, up("b", 1.5)[1])[1]
    for others in ((*up("a"), *up("b")), up("b")):
        assert not any(isinstance(each, GiveUp) for each in after(*others, repeated)[1])


@pytest.mark.parametrize(("at", "reason"), [(10.0, "no progress for 10 s"), (60.0, "not done after 60 s")])
def test_a_hung_worker_is_shunned(at: float, reason: str) -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0])]
    if at == 60.0:
        history += [busy(R[0], at=second, progress=second) for second in range(1, 60)]
    state, actions = after(*history, Tick(at))
    assert actions == [Revoke("w", first(R[0])), Fail("w", first(R[0]), Failure("infrastructure", reason)), GiveUp("w")]
    assert after(*history, Tick(at - 0.1))[1] == []
    # A heartbeat without progress is no sign of life, and a lost cancel is sent again.
    assert step(state, busy(R[0], at=at, progress=99))[1] == (Revoke("w", first(R[0])),)
    assert step(state, idle(at=at))[1] == (Start("w", first(R[0], 2)),)


@pytest.mark.parametrize(
    "history",
    [
        [*up(), want(R[0]), busy(R[0]), Unwanted(0, (R[0],))],
        [WorkerUp(0, "w"), busy(R[0])],
        [want(R[0]), *up("v"), WorkerUp(0, "w"), busy(R[0], 9)],
    ],
)
def test_a_worker_that_does_not_heed_a_cancel_is_given_up(history: list[Event]) -> None:
    state, actions = after(*history, busy(R[0], 9, at=9.9))
    assert actions == [Revoke("w", first(R[0], 9))]
    assert GiveUp("w") not in step(state, Tick(9.9))[1]
    state, actions = after(*history, Tick(10))
    assert GiveUp("w") in actions
    assert GiveUp("w") not in step(state, Tick(19.9))[1]
    assert GiveUp("w") in step(state, Tick(20))[1]
    assert GiveUp("w") not in step(step(state, idle(at=11))[0], Tick(20))[1]


@pytest.mark.parametrize("workers", [1, 1000, 10_000])
@pytest.mark.parametrize("lost", [0, 2], ids=["all arrive", "two of three are lost"])
def test_heartbeats_of_a_large_fleet_keep_a_worker_and_find_a_hung_one_in_time(workers: int, lost: int) -> None:
    hung_after = LIMITS.hung_after
    interval = heartbeat_interval(workers, hung_after)
    state, _ = after(*up(), want(R[0]), busy(R[0]))
    hangs_at = 12 * interval + 0.1
    for number in range(1, int((hangs_at + 3 * hung_after) / 0.25)):
        at = number * 0.25
        if at % interval == 0 and (at / interval) % (lost + 1) == 0:
            state, _ = step(state, busy(R[0], at=at, progress=int(1000 * min(at, hangs_at))))
        state, actions = step(state, Tick(at))
        if actions:
            break
    assert GiveUp("w") in actions
    assert hangs_at < at <= hangs_at + (lost + 1) * interval + hung_after + 0.25


def test_progress_keeps_a_worker() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), busy(R[0], at=9, progress=1)]
    assert after(*history, Tick(18.9))[1] == []
    assert after(*history, busy(R[0], at=15, progress=1), Tick(19))[1] != []


def test_a_lost_worker_loses_its_attempt_after_a_while() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), WorkerDown(1, "w")]
    assert after(*history, Tick(3.9))[1] == []
    state, actions = after(*history, Tick(4))
    assert actions == [Fail("w", first(R[0]), Failure("infrastructure", "worker lost for 3 s"))]
    assert (state.workers, state.waiting) == ({}, (R[0],))


def test_a_worker_behind_a_router_that_restarts_has_the_grace_period() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), RouterChanged(1, 30), WorkerDown(1, "w")]
    assert after(*history, Tick(30.9))[1] == []
    back = after(*history, Tick(25), RouterChanged(25, 30), WorkerUp(25.5, "w"), Tick(26))
    assert (back[1], back[0].workers["w"].phase) == ([], "busy")
    failed = Fail("w", first(R[0]), Failure("infrastructure", "worker lost for 3 s"))
    assert after(*history, Tick(31))[1] == [failed], "the router is long gone, and so is its worker"


def test_the_grace_period_is_only_for_routers_that_changed_lately() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), RouterChanged(1, 30), busy(R[0], at=39, progress=1)]
    assert after(*history, WorkerDown(40, "w"), Tick(42.9))[1] == []
    assert after(*history, WorkerDown(40, "w"), Tick(43))[1] != []


def test_nobody_is_lost_while_the_own_link_is_down() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), WorkerDown(1, "w"), LinkChanged(1.2, 30, up=False)]
    assert after(*history, Tick(500))[1] == []
    found: list[Event] = [*history, LinkChanged(500, 30, up=True)]
    assert after(*found, Tick(529.9))[1] == []
    assert after(*found, Tick(530))[1] != [], "it has had its time to return"


def test_time_behind_a_dead_link_does_not_count_against_the_deadline() -> None:
    """Its result may be the next message, and a missed deadline would blame the rollout."""
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), WorkerDown(1, "w"), LinkChanged(1.2, 30, up=False)]
    back: list[Event] = [*history, LinkChanged(700, 30, up=True), WorkerUp(701, "w"), Tick(702)]
    state, actions = after(*back)
    assert (actions, state.workers["w"].phase) == ([], "busy")
    assert after(*back, done(R[0], at=703))[1][0] == Record("w", first(R[0]))


def test_a_worker_that_withdraws_its_token_does_not_escape_its_deadline() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0])]
    for at in range(0, 60, 6):
        history += [WorkerDown(at + 0.5, "w"), WorkerUp(at + 3, "w"), busy(R[0], at=at + 3, progress=at + 1)]
    actions = after(*history, Tick(60))[1]
    assert [each.failure.reason for each in actions if isinstance(each, Fail)] == ["not done after 60 s"]


def test_a_short_silence_costs_nothing() -> None:
    history: list[Event] = [*up(), want(R[0]), busy(R[0]), WorkerDown(9, "w"), WorkerUp(11, "w")]
    state, actions = after(*history, Tick(12))
    assert (actions, state.workers["w"].phase) == ([], "busy")


def test_what_is_withdrawn_is_cancelled_and_forgotten() -> None:
    history: list[Event] = [*up(), want(R[0], R[1]), busy(R[0])]
    state, actions = after(*history, Unwanted(1, (R[0], R[1])))
    assert actions == [Revoke("w", first(R[0]))]
    assert (state.open, state.waiting, state.workers["w"].phase) == ({}, (), "shunned")
    assert step(state, done(R[0]))[1] == (Acknowledge("w", first(R[0])),)
    back, _ = after(*history, WorkerDown(1, "w"), Unwanted(1, (R[0],)), WorkerUp(1, "w"))
    assert back.workers["w"].phase == "shunned"


def test_check_finds_a_broken_state() -> None:
    good, _ = after(*up(), want(R[0], R[1]))
    held, free = good.workers["w"], replace(good.workers["w"], attempt=None)
    for broken in (
        replace(good, workers={"w": held, "v": held}),
        replace(good, open={R[1]: good.open[R[1]]}),
        replace(good, waiting=(R[0], R[1])),
        replace(good, waiting=(R[1], R[1])),
        replace(good, waiting=(R[1], R[2])),
        replace(good, waiting=()),
        replace(good, workers={"w": free}, waiting=(R[0], R[1])),
    ):
        with pytest.raises(AssertionError):
            check_invariants(broken)


# A world


@dataclass(frozen=True)
class Chaos:
    """Faults of the first `until` seconds; none after them."""

    seed: int
    loss: float
    duplication: float
    delay: float
    deaths: int
    hangs: int
    partitions: int
    restarts: int
    failing: float
    broken: int = 0
    """Workers that fail in all they do, one after another on two hosts, until they are replaced."""
    until: float = 30.0


@dataclass
class Process:
    """A worker process, as `perfbound.workers.worker` behaves."""

    name: str
    host: str
    broken: bool = False
    alive: bool = True
    linked: bool = True
    hung: bool = False
    accepted: Attempt | None = None
    queue: list[Attempt] = field(default_factory=list)
    running: Attempt | None = None
    progress: int = 0
    cancelled: set[Attempt] = field(default_factory=set)
    outbox: dict[Attempt, Failure | None] = field(default_factory=dict)


class World:
    """Workers, a network and an orchestrator that mirrors `Service`, on one simulated clock."""

    def __init__(
        self, chaos: Chaos, rollouts: int, workers: int, limits: Limits, always_fails: frozenset[WorkId]
    ) -> None:
        self.chaos, self.limits, self.rng = chaos, limits, random.Random(chaos.seed)
        self.rollouts = [RolloutId("p", test, "true", 0) for test in range(rollouts)]
        self.always_fails = always_fails
        self.now, self._order = 0.0, itertools.count()
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self.processes: dict[str, Process] = {}
        self._names = itertools.count()
        # Durable state
        self.recorded: list[WorkId] = []
        self.started: set[Attempt] = set()
        self.failures: dict[WorkId, int] = {}
        self.poison: dict[WorkId, tuple[Fail, ...]] = {}
        self.generation = 0
        self._restart()
        for number in range(workers):
            self._spawn(broken=number < min(chaos.broken, workers - 1))
        self._trouble()
        self._every(0.25, lambda: self._take(Tick(self.now)))

    def run(self, until: float) -> None:
        while self._agenda and self.now < until and len(self.recorded) + len(self.poison) < len(self.rollouts):
            self.now, _, act = heapq.heappop(self._agenda)
            act()

    # Time

    def _at(self, when: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._agenda, (when, next(self._order), act))

    def _every(self, period: float, act: Callable[[], None]) -> None:
        def again() -> None:
            act()
            self._at(self.now + period, again)

        self._at(self.now + period, again)

    def _trouble(self) -> None:
        def random_time() -> float:
            return self.rng.uniform(0.0, self.chaos.until)

        for count, act in (
            (self.chaos.deaths, self._kill_one),
            (self.chaos.hangs, self._hang_one),
            (self.chaos.partitions, self._part_one),
            (self.chaos.restarts, self._restart),
        ):
            for _ in range(count):
                self._at(random_time(), act)

    def _some_process(self) -> Process:
        return self.rng.choice([process for process in self.processes.values() if process.alive])

    # The network

    def _carry(self, process: Process, act: Callable[[], None]) -> None:
        bad = self.now < self.chaos.until
        if bad and (not process.linked or self.rng.random() < self.chaos.loss):
            return
        copies = 1 + (bad and self.rng.random() < self.chaos.duplication)
        for _ in range(copies):
            self._at(self.now + (self.rng.uniform(0, self.chaos.delay) if bad else 0.001), act)

    def _to_orchestrator(self, process: Process, event: Callable[[], Event], *, always: bool = False) -> None:
        if always:
            self._at(self.now, lambda: self._take(event()))
            return
        generation = self.generation
        self._carry(process, lambda: self._take(event()) if generation == self.generation else None)

    # The orchestrator

    def _restart(self) -> None:
        self.generation += 1
        attempts: dict[WorkId, int] = {}
        for attempt in self.started:
            attempts[attempt.rollout] = max(attempts.get(attempt.rollout, 0), attempt.number)
        self.state = DispatchState(self.limits, self.now + 2.5 if self.generation > 1 else 0.0)
        self.tokens = {process.name for process in self.processes.values() if process.alive and process.linked}
        self.known: set[str] = set()
        missing = [each for each in self.rollouts if each not in self.recorded and each not in self.poison]
        self._take(Wanted(self.now, tuple((each, attempts.get(each, 0)) for each in missing)))

    def _take(self, event: Event) -> None:
        """Do what `Service` does with a message."""
        if isinstance(event, WorkerUp | WorkerDown):
            (self.tokens.add if isinstance(event, WorkerUp) else self.tokens.discard)(event.worker)
            if event.worker not in self.known:
                return
        if isinstance(event, Reported):
            if event.worker not in self.tokens:
                return
            if event.worker not in self.known:
                self.known.add(event.worker)
                self._step(WorkerUp(self.now, event.worker, self.processes[event.worker].host))
        if isinstance(event, Delivered) and event.worker not in self.known:
            return
        self._step(event)

    def _step(self, event: Event) -> None:
        before = self.state
        self.state, actions = step(before, event)
        if isinstance(event, Delivered) and event.failure is not None and event.failure.kind == "system":
            recorded = Fail(event.worker, event.attempt, event.failure)
            assert recorded in actions, "no failure of the system is acknowledged without a record"
        for action in actions:
            self._act(action, before, event)

    def _act(self, action: Action, before: DispatchState, event: Event) -> None:
        match action:
            case Start(worker, attempt):
                assert attempt not in self.started, "attempt numbers never repeat"
                assert worker in self.tokens, "nothing is assigned to a worker that is gone"
                phase = before.workers[worker].phase
                if phase in ("new", "shunned"):
                    assert isinstance(event, Reported), "a worker reports idle before its first attempt"
                    assert (event.worker, event.attempt) == (worker, None)
                self.started.add(attempt)
                self._send(worker, self._assigned, attempt)
            case Resend(worker, attempt):
                self._send(worker, self._assigned, attempt)
            case Revoke(worker, attempt):
                self._send(worker, self._cancel, attempt)
            case Acknowledge(worker, attempt):
                self._send(worker, lambda process, acked: process.outbox.pop(acked, None), attempt)
            case Record(worker, attempt):
                assert attempt.rollout not in self.recorded, "recorded once"
                assert attempt.rollout not in self.always_fails
                self.recorded.append(attempt.rollout)
            case GiveUp(worker):
                self._at(self.now, lambda: self._kill(self.processes[worker]))
            case Poison(rollout, reasons):
                assert rollout not in self.poison, "poison is reported once"
                alike = [each for each in reasons if each.failure == reasons[-1].failure == RAISED]
                assert len(alike) == 2 or len(reasons) == self.limits.max_attempts
                assert len(set(reasons)) == len(reasons), "no failure counts twice"
                self.poison[rollout] = reasons
            case SetAside(place):
                left = {name for name, each in self.state.workers.items() if place.name not in (name, each.host)}
                assert left, "somebody else is there"
            case Fail() | TakeBack() | AwaitOther():
                pass

    def _send(self, worker: str, act: Callable[[Process, Attempt], Any], attempt: Attempt) -> None:
        process = self.processes[worker]
        self._carry(process, lambda: act(process, attempt) if process.alive else None)

    # The workers

    def _spawn(self, *, broken: bool = False) -> None:
        number = next(self._names)
        process = Process(f"w{number}", f"h{number % 2}", broken=broken)
        self.processes[process.name] = process
        self._to_orchestrator(process, lambda: WorkerUp(self.now, process.name, process.host), always=True)
        self._every(0.5, lambda: self._beat(process))
        self._every(1.0, lambda: self._deliver(process))
        self._every(0.3, lambda: self._work(process))

    def _beat(self, process: Process) -> None:
        if process.alive:
            current = process.accepted
            progress = process.progress if current == process.running else 0
            self._to_orchestrator(process, lambda: Reported(self.now, process.name, current, progress))

    def _deliver(self, process: Process) -> None:
        for attempt, failure in process.outbox.items() if process.alive else ():
            self._hand_in(process, attempt, failure)

    def _hand_in(self, process: Process, attempt: Attempt, failure: Failure | None) -> None:
        self._to_orchestrator(process, lambda: Delivered(self.now, process.name, attempt, failure))

    def _assigned(self, process: Process, attempt: Attempt) -> None:
        current = process.accepted
        repeat = current and current.rollout == attempt.rollout and current.number >= attempt.number
        if attempt not in process.outbox and not repeat:
            process.accepted = attempt
            process.queue.append(attempt)

    def _cancel(self, process: Process, attempt: Attempt) -> None:
        process.cancelled.add(attempt)

    def _work(self, process: Process) -> None:
        if not process.alive or process.hung:
            return
        if process.running is None:
            process.running, process.progress = (process.queue.pop(0) if process.queue else None), 0
            return
        attempt = process.running
        process.progress += 1
        if attempt in process.cancelled:
            self._finish(process)
        elif process.broken or self.rng.random() < 0.08:  # four seconds a rollout
            failing = self.chaos.failing if self.now < self.chaos.until else 0.0
            failure: Failure | None = None
            if attempt.rollout in self.always_fails:
                failure = self.rng.choice([BAD, RAISED])
            elif process.broken:
                failure = BAD
            elif self.rng.random() < failing:  # never twice with one reason
                failure = self.rng.choice([BAD, Failure("system", str(attempt))])
            process.outbox[attempt] = failure
            self._finish(process)
            self._hand_in(process, attempt, failure)

    def _finish(self, process: Process) -> None:
        if process.accepted == process.running:
            process.accepted = None
        process.running = None

    def _kill_one(self) -> None:
        self._kill(self._some_process())

    def _kill(self, process: Process) -> None:
        """Kill a process; another one takes its place."""
        if process.alive:
            process.alive = False
            self._to_orchestrator(process, lambda: WorkerDown(self.now, process.name), always=True)
            self._spawn()

    def _hang_one(self) -> None:
        self._some_process().hung = True

    def _part_one(self) -> None:
        process = self._some_process()
        if not process.linked:
            return
        process.linked = False
        self._to_orchestrator(process, lambda: WorkerDown(self.now, process.name), always=True)

        def heal() -> None:
            process.linked = True
            if process.alive:
                self._to_orchestrator(process, lambda: WorkerUp(self.now, process.name, process.host), always=True)

        self._at(self.now + self.rng.uniform(0.1, 8.0), heal)


PATIENT = Limits(hung_after=5.0, deadline=30.0, max_attempts=1000)
chaos = st.builds(
    Chaos,
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.1, 0.5]),
    duplication=st.sampled_from([0.0, 0.3]),
    delay=st.sampled_from([0.001, 0.7, 4.0]),
    deaths=st.integers(0, 4),
    hangs=st.integers(0, 2),
    partitions=st.integers(0, 4),
    restarts=st.integers(0, 3),
    failing=st.sampled_from([0.0, 0.3]),
    broken=st.integers(0, 3),
)


@pytest.mark.rest
@settings(max_examples=100, deadline=None)
@given(chaos, st.integers(1, 25), st.integers(1, 4))
def test_every_rollout_is_recorded_exactly_once_whatever_happens(found: Chaos, rollouts: int, workers: int) -> None:
    world = World(found, rollouts, workers, PATIENT, frozenset())
    world.run(until=400.0)
    assert sorted(world.recorded) == world.rollouts, f"not done at {world.now:g} s"
    assert (world.state.open, world.state.waiting) == ({}, ())


@settings(max_examples=30, deadline=None)
@given(chaos, st.integers(1, 3))
def test_a_rollout_that_always_fails_is_poison_and_no_other_is(found: Chaos, workers: int) -> None:
    calm = replace(found, failing=0.0, broken=0, deaths=0, hangs=0, partitions=0, loss=0.0, delay=min(found.delay, 0.7))
    bad = frozenset({RolloutId("p", 1, "true", 0)})
    world = World(calm, 5, workers, replace(PATIENT, max_attempts=4, hung_after=20.0), bad)
    world.run(until=400.0)
    assert set(world.poison) == bad
    assert len(world.recorded) == 4
