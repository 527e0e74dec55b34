"""The wait for another worker: when it begins, for whom, and how it ends."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.fleet.dispatch import machine
from perfbound.orchestrator.fleet.dispatch.events import (
    Action,
    AwaitOther,
    Delivered,
    EarlierFailure,
    Event,
    Fail,
    GiveUp,
    HandOut,
    LinkChanged,
    Opinion,
    Outvoted,
    Poison,
    Record,
    Reported,
    RouterChanged,
    Start,
    Tick,
    Unwanted,
    Wanted,
    WorkerDown,
    WorkerUp,
)
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.opinions import without
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId
from tests.fakes.fleets import Fleet, Member
from tests.fakes.invariants import check_invariants

R0, R1, R2 = (RolloutId("p", test, "true", 0) for test in range(3))
RAISED, BROKE = Failure("system", "it raised"), Failure("infrastructure", "it broke")
LIMITS = Limits()
DECIDES = AwaitOther | GiveUp | Start | Record | Poison | Outvoted


def play(state: DispatchState, *events: Event) -> tuple[DispatchState, list[Action]]:
    """Take events, each with a hand-out behind it; return the actions that decide something."""
    found: list[Action] = []
    for event in events:
        for each in (event, HandOut(event.at)):
            state, actions = machine.advance(state, each)
            check_invariants(state)
            found += [each for each in actions if isinstance(each, DECIDES)]
    return state, found


def up(at: float, *workers: str) -> list[Event]:
    return [event for name in workers for event in (WorkerUp(at, name, name), Reported(at, name, None, 0))]


def sends(at: float, worker: str, number: int, digest: str, rollout: RolloutId = R0) -> Delivered:
    return Delivered(at, worker, Attempt(rollout, number), None, digest)


def fails(at: float, worker: str, number: int, failure: Failure = RAISED) -> Delivered:
    return Delivered(at, worker, Attempt(R0, number), failure)


def starts(worker: str, number: int, rollout: RolloutId = R0) -> Start:
    return Start(worker, Attempt(rollout, number))


def opinion(number: int, worker: str, digest: str) -> Opinion:
    return Opinion(worker, worker, Attempt(R0, number), digest)


WAITS = AwaitOther(R0, 60.0)
COMPARED = Wanted(0.0, ((R0, 0),), compared=frozenset({R0}))


# For whom


def b_has(rollout: RolloutId) -> list[Event]:
    return [*up(0.0, "b"), Wanted(0.1, ((rollout, 0),))]


DOWN, BACK = WorkerDown(0.5, "b"), WorkerUp(0.9, "b", "b")
ROUTER, CUT = RouterChanged(0.6, 30.0), LinkChanged(0.6, 30.0, up=False)
CANCELLED = [*b_has(R1), Unwanted(0.5, (R1,))]
ANSWERS = [sends(1.0, "a", 1, "d"), fails(1.0, "a", 1)]
"""Both ask for another worker."""
AGAIN = [GiveUp("a"), starts("a", 2)]


def asked(*events: Event, answer: Event = ANSWERS[0]) -> tuple[DispatchState, list[Action]]:
    """Return the state after `a` alone has R0, these events, and its answer; and what that answer decides."""
    state, _ = play(DispatchState(LIMITS, second_opinion=True), *up(0.0, "a"), COMPARED, *events)
    return play(state, answer)


@pytest.mark.parametrize("answer", ANSWERS, ids=["compared", "failed"])
@pytest.mark.parametrize(
    ("events", "until"),
    [
        ([*up(0.1, "b"), DOWN], 3.5),
        ([*up(0.1, "b"), DOWN, ROUTER], 30.5),
        ([*up(0.1, "b"), ROUTER, WorkerDown(0.6, "b")], 30.6),
        ([*up(0.1, "b"), DOWN, CUT], 61.0),
        ([WorkerUp(0.1, "b", "b")], 10.1),
        ([*up(0.1, "b"), DOWN, Tick(3.5), WorkerUp(3.5, "b", "b")], 13.5),
        (CANCELLED, 10.5),
    ],
    ids=["gone", "router", "router first", "no link", "new", "new again", "cancelled"],
)
def test_a_rollout_waits_for_one_that_has_not_tried_it_and_no_longer(
    events: list[Event], until: float, answer: Delivered
) -> None:
    state, actions = asked(*events, answer=replace(answer, at=max(1.0, events[-1].at)))
    assert actions == [WAITS]
    state, actions = play(state, Tick(until - 0.1))
    assert actions == []
    assert Start("b", Attempt(R0, 2)) in play(state, WorkerUp(until - 0.1, "b"), Reported(until, "b", None, 0))[1]
    _, actions = play(state, Tick(until), Tick(until))
    assert [each for each in actions if each != GiveUp("b")] == AGAIN, "its own worker, afresh where it can"


@pytest.mark.parametrize("answer", ANSWERS, ids=["compared", "failed"])
@pytest.mark.parametrize(
    "events",
    [
        [],
        [*up(0.1, "b"), replace(DOWN, replaced=True)],
        [*up(0.1, "b"), Reported(0.2, "b", None, 0, leaving=True)],
        [*up(0.1, "b"), Reported(0.2, "b", None, 0, leaving=True), DOWN],
        [*up(0.1, "b"), DOWN, Tick(3.5)],
    ],
    ids=["alone", "local", "leaves", "has left", "lost"],
)
def test_it_does_not_wait_for_one_that_does_not_come(events: list[Event], answer: Delivered) -> None:
    state, actions = asked(*events, answer=replace(answer, at=max([1.0, *(each.at for each in events)])))
    assert actions == AGAIN
    assert state.waiting == ()


def test_it_does_not_wait_for_one_that_is_set_aside_or_has_tried_it_as_well() -> None:
    state = DispatchState(LIMITS, standings=without({}, ["b"]), second_opinion=True)
    _, actions = play(state, *up(0.0, "a", "b"), COMPARED, DOWN, ANSWERS[0])
    assert actions == [starts("a", 1), *AGAIN]
    both = Wanted(
        0.0, ((R0, 2),), compared=frozenset({R0}), opinions={R0: (opinion(1, "a", "x"), opinion(2, "b", "y"))}
    )
    _, actions = play(replace(state, standings={}), *up(0.0, "a", "b"), DOWN, both)
    assert actions == [starts("a", 3)]


@pytest.mark.parametrize(
    ("wanted", "answers"),
    [
        (Wanted(0.0, ((R0, 0),)), [fails(1.0, "a", 1, BROKE)]),
        (Wanted(0.0, ((R0, 0),)), [replace(sends(1.0, "a", 1, "d"), doubtful=True)]),
        (Wanted(0.0, ((R0, 0),), avoid={R0: "a"}), []),
    ],
    ids=["infrastructure", "doubt", "recheck"],
)
def test_what_any_worker_may_repeat_waits_for_nobody(wanted: Wanted, answers: list[Event]) -> None:
    state, _ = play(DispatchState(LIMITS, alone_from=60.0), *up(0.0, "a", "b"), DOWN)
    _, actions = play(state, wanted, *answers)
    assert actions == [starts("a", 1 + number) for number in range(1 + len(answers))]


# What waits


def test_all_other_rollouts_continue_and_one_line_says_what_waits() -> None:
    more = Wanted(0.0, ((R1, 0), (R2, 0)), compared=frozenset({R1, R2}))
    state, actions = asked(*up(0.1, "b"), DOWN, more)
    assert actions == [WAITS, starts("a", 1, R1)]
    state, actions = play(state, sends(1.1, "a", 1, "d", R1))
    assert actions == [starts("a", 1, R2)], "R1 waits without a line of its own"
    state, actions = play(state, *up(2.0, "b"))
    assert actions == [starts("b", 2, R1)]
    assert play(state, sends(2.1, "b", 2, "d", R1))[1] == [Record("b", Attempt(R1, 2)), starts("b", 2)]


def test_a_worker_that_is_busy_when_the_wait_ends_is_given_up_before_it_repeats_the_rollout() -> None:
    state, actions = asked(*up(0.1, "b"), DOWN, Wanted(0.2, ((R1, 0),)))
    assert actions == [WAITS, starts("a", 1, R1)]
    state, actions = play(state, Tick(3.5), Tick(4.0))
    assert actions == []
    state, actions = play(state, Unwanted(4.5, (R1,)), Reported(5.0, "a", None, 0))
    assert actions == [GiveUp("a")]
    assert play(state, Tick(5.1))[1] == [starts("a", 2)], "one from elsewhere cannot be replaced"
    state, actions = play(state, WorkerDown(5.0, "a", replaced=True), *up(6.0, "c"))
    assert actions == [starts("c", 2)]


def test_time_in_which_nobody_could_repeat_it_does_not_count() -> None:
    """The link ends for an hour, and the worker that has tried the rollout returns first."""
    state, _ = asked(*up(0.1, "b"), DOWN, CUT)
    state, actions = play(state, WorkerDown(1.1, "a"), *(Tick(float(at)) for at in range(2, 3600)))
    assert actions == []
    state, actions = play(state, WorkerUp(3600.0, "a"), Tick(3600.1), LinkChanged(3600.2, 30.0, up=True), Tick(3601.0))
    assert actions == []
    assert play(state, WorkerUp(3602.0, "b"))[1] == [starts("b", 2)]
    assert play(state, Tick(3630.2), Tick(3630.3))[1] == AGAIN


# Decisions


def test_a_router_that_restarts_during_a_dispute_costs_a_moment() -> None:
    state = DispatchState(LIMITS, second_opinion=True)
    wanted = Wanted(0.2, ((R0, 0), (R1, 0)), compared=frozenset({R0}))
    state, _ = play(state, *up(0.0, "a", "b", "c"), wanted, sends(1.0, "a", 1, "x"), sends(1.5, "c", 2, "y"))
    gone = [WorkerDown(2.0, name) for name in "abc"]
    state, actions = play(state, RouterChanged(2.0, 30.0), *gone, RouterChanged(3.0, 30.0), WorkerUp(3.1, "a"))
    assert actions == [WAITS]
    state, actions = play(state, WorkerUp(3.6, "b"), WorkerUp(3.7, "c"), sends(4.0, "b", 1, "d", R1))
    assert actions == [starts("a", 2, R1), starts("b", 3)], "the first results of b are compared as well"
    actions = play(state, sends(5.0, "b", 3, "y"))[1]
    assert [type(each) for each in actions] == [Outvoted, GiveUp, Record]


AFTER_RESUME = DispatchState(LIMITS, hold_until=2.5, alone_from=62.5, second_opinion=True)


@pytest.mark.parametrize("digests", ["xy", "xyz"], ids=["two differ", "without a majority"])
def test_after_a_resume_a_worker_that_reports_first_does_not_end_a_dispute(digests: str) -> None:
    before = tuple(opinion(number, name, name + "!") for number, name in enumerate("abc"[: len(digests)], 1))
    count = len(before)
    wanted = Wanted(0.0, ((R0, count), (R1, 0)), compared=frozenset({R0}), opinions={R0: before})
    state, actions = play(AFTER_RESUME, wanted, *up(0.2, "a"), Tick(2.5))
    assert actions == [WAITS, starts("a", 1, R1)]
    state, actions = play(state, sends(3.0, "a", 1, "d", R1), *up(3.0, "b"), Tick(62.4))
    assert actions == [Record("a", Attempt(R1, 1))]
    _, actions = play(state, *up(62.4, "d"), sends(62.6, "d", count + 1, "a!"))
    assert Record("d", Attempt(R0, count + 1)) in actions
    assert {each.worker for each in actions if isinstance(each, Outvoted)} == {*"abc"[1:count]}
    state, actions = play(state, Tick(62.5), Tick(62.6))
    assert actions == [GiveUp("a"), starts("a", count + 1)], "nobody has come"
    assert isinstance(play(state, sends(63.0, "a", count + 1, "a!"))[1][0], Poison)


def test_a_repeat_that_began_before_the_restart_ends_nothing_while_others_may_come() -> None:
    before = (opinion(1, "a", "x"), opinion(2, "b", "y"))
    wanted = Wanted(0.0, ((R0, 3),), compared=frozenset({R0}), opinions={R0: before})
    adopted = Reported(0.2, "a", Attempt(R0, 3), 1)
    state, actions = play(AFTER_RESUME, wanted, WorkerUp(0.1, "a", "a"), adopted, sends(3.0, "a", 3, "x"))
    assert actions == [WAITS]
    assert play(state, *up(4.0, "c"))[1] == [starts("c", 4)]


def test_two_failures_of_one_worker_are_no_poison_while_others_may_come() -> None:
    state, _ = asked(*up(0.1, "b"), answer=Tick(1.0))
    state, actions = play(state, ROUTER, DOWN, fails(1.0, "a", 1), fails(1.1, "a", 2), Tick(30.4))
    assert actions == [WAITS]
    assert play(state, WorkerUp(30.4, "b"))[1] == [starts("b", 2)]
    state, actions = play(state, Tick(30.5), Tick(30.6), fails(31.0, "a", 2))
    assert actions[:2] == AGAIN
    assert isinstance(actions[2], Poison), "alone, twice is enough"


@pytest.mark.parametrize("banned", [[], ["b"]], ids=["one opinion", "the other one is outvoted"])
def test_a_worker_that_is_alone_after_a_resume_agrees_with_itself_at_once(banned: list[str]) -> None:
    before = (opinion(1, "a", "x"), opinion(2, "b", "y"))[: 1 + len(banned)]
    state = replace(AFTER_RESUME, standings=without({}, banned))
    wanted = Wanted(0.0, ((R0, 2),), compared=frozenset({R0}), opinions={R0: before})
    state, actions = play(state, wanted, *up(0.2, "a"), Tick(2.5))
    assert actions == [starts("a", 3)]
    assert play(state, sends(3.0, "a", 3, "x"))[1] == [Record("a", Attempt(R0, 3))]


def test_failures_before_a_resume_wait_for_another_worker_as_well() -> None:
    failed = EarlierFailure(Fail("a", Attempt(R0, 1), RAISED), "a")
    wanted = Wanted(0.0, ((R0, 1),), failed={R0: (failed,)})
    state, actions = play(AFTER_RESUME, wanted, *up(0.2, "a"), Tick(2.5))
    assert actions == [WAITS]
    assert play(state, *up(3.0, "b"))[1] == [starts("b", 2)]


# Whatever happens


@pytest.mark.rest
@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 40.0), st.floats(0.5, 25.0), st.tuples(*[st.floats(0.0, 4.0)] * 3)), max_size=3),
    st.sets(st.integers(0, 11)),
)
def test_routers_that_return_within_their_grace_end_no_campaign(
    outages: list[tuple[float, float, tuple[float, ...]]], compared: set[int]
) -> None:
    """Of three workers one lies; all are out of reach for a while, and each returns at another time."""
    found = Fleet({name: Member(name, "good") for name in "abc"}, 12, second_opinion=tuple(compared))
    found.members["a"].behaviour = "lies"
    agenda = sorted((begin, length, lags) for begin, length, lags in outages)
    for begin, length, lags in agenda:
        found.run(max(0.0, begin - found.now))
        found.cut(length, dict(zip("abc", lags, strict=True)))
    found.run(300.0)
    assert found.poison is None
    assert len(found.recorded) == 12
    assert set(found.true.values()) == {True}, "it lies from the start, and its first results are compared"
