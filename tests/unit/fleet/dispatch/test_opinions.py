"""Second opinions: who is asked, who is outvoted, and what counts."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.fleet.dispatch import machine
from perfbound.orchestrator.fleet.dispatch.choice import is_outvoted
from perfbound.orchestrator.fleet.dispatch.events import (
    Acknowledge,
    Compared,
    Delivered,
    Fail,
    GiveUp,
    HandOut,
    Opinion,
    Outvoted,
    Poison,
    Record,
    Reported,
    SetAside,
    Start,
    Wanted,
    WorkerUp,
)
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.opinions import UNLIKE, contradicts, has_all_of, without
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId, first_of
from tests.facts import says
from tests.fakes.fleets import Behaviour, Fleet, Member
from tests.fakes.invariants import check_invariants

R0 = RolloutId("p", 0, "true", 0)


def fleet(rollouts: int, compared: tuple[int, ...] | None, **workers: Behaviour) -> Fleet:
    """Return workers by name; the part of a name before _ is the host."""
    members = {name: Member(name.split("_")[0], each) for name, each in workers.items()}
    return Fleet(members, rollouts, second_opinion=compared)


def test_without_the_key_nothing_is_compared() -> None:
    found = fleet(20, None, a="good", b="lies")
    found.run(100)
    assert len(found.starts) == 20
    assert False in found.true.values()


def test_a_chosen_rollout_is_simulated_by_two_workers_of_two_hosts() -> None:
    found = fleet(30, (10, 20), h_1="good", h_2="good", k="good")
    found.run(300)
    assert len(found.recorded) == 30
    for test in (10, 20):
        hosts = {
            start.worker.split("_")[0] for _, start in found.starts if first_of(start.attempt.rollout).test == test
        }
        assert hosts == {"h", "k"}


def test_the_first_three_results_of_every_worker_are_compared() -> None:
    found = fleet(40, (), a="good", b="good", c="good")
    found.run(300)
    assert 5 <= len(found.starts) - 40 <= 9


def test_a_worker_that_lies_from_the_start_is_outvoted_and_nothing_of_it_is_recorded() -> None:
    found = fleet(40, (), a="lies", b="good", c="good")
    found.run(300)
    assert found.outvoted == ["a"]
    assert set(found.recorded.values()) == {"b", "c"}
    assert set(found.true.values()) == {True}
    ((when, reason),) = [(at, each.reason) for at, each in found.pauses if isinstance(each, SetAside)]
    assert reason.startswith("its trajectory of p.")
    assert reason.endswith((" differs from that of two others (b, c)", " differs from that of two others (c, b)"))
    assert all(at <= when for at, start in found.starts if start.worker == "a"), "set aside for good"


def test_a_worker_that_begins_to_lie_is_outvoted_at_the_next_chosen_rollout() -> None:
    found = fleet(60, (30, 40, 50), a="good", b="good", c="good")
    found.run(14)
    found.members["a"].behaviour = "lies"
    found.run(300)
    assert found.outvoted == ["a"]
    assert len(found.recorded) == 60


def test_two_that_differ_ask_a_third_and_without_a_majority_the_rollout_is_poison() -> None:
    found = fleet(5, (0,), a="lies", b="good", c="slow")
    found.run(100)
    assert found.true[R0]
    found = fleet(5, (0,), a="lies", b="good")
    found.run(60)
    assert found.poison is not None, "a worker that repeats itself is no majority"
    found = fleet(5, (0,), a="lies", b="lies", c="lies")
    found.run(60)
    assert found.poison is not None
    assert "a trajectory like no other one" in found.poison.failures[-1].failure.reason
    assert len(found.poison.failures) == 3


def deliver(state: DispatchState, number: int, digest: str, worker: str = "w") -> tuple[DispatchState, list[object]]:
    state, actions = machine.advance(state, Delivered(1.0, worker, Attempt(R0, number), None, digest))
    state, starts = machine.advance(state, HandOut(1.0))
    return state, [*actions, *starts]


@pytest.fixture
def alone() -> DispatchState:
    """A state in which the only worker has the rollout that is compared."""
    state = DispatchState(Limits(), second_opinion=True)
    wanted = Wanted(0.0, ((R0, 0),), compared=frozenset({R0}))
    for event in (wanted, WorkerUp(0.0, "w", "h"), Reported(0.0, "w", None, 0), HandOut(0.0)):
        state, _ = machine.advance(state, event)
    return state


def test_the_only_worker_simulates_again_in_a_fresh_process_where_it_can(alone: DispatchState) -> None:
    state, actions = deliver(alone, 1, "d")
    assert actions == [
        Compared("w", Attempt(R0, 1), "d"),
        GiveUp("w"),
        Acknowledge("w", Attempt(R0, 1)),
        Start("w", Attempt(R0, 2)),
    ]
    assert Record("w", Attempt(R0, 2)) in deliver(state, 2, "d")[1]


def test_a_result_that_comes_twice_is_one_opinion(alone: DispatchState) -> None:
    state, _ = deliver(alone, 1, "d")
    again, actions = deliver(state, 1, "d")
    assert actions == [Acknowledge("w", Attempt(R0, 1))]
    assert again.open[R0].opinions == state.open[R0].opinions


def test_a_worker_that_differs_from_itself_is_poison(alone: DispatchState) -> None:
    state, _ = deliver(alone, 1, "d")
    state, _ = deliver(state, 2, "e")
    assert any(isinstance(action, Poison) for action in deliver(state, 3, "f")[1])


def test_a_worker_that_is_alone_and_contradicts_itself_never_agrees(alone: DispatchState) -> None:
    state, _ = deliver(alone, 1, "d")
    state, _ = deliver(state, 2, "e")
    state, actions = deliver(state, 3, "e")
    assert any(isinstance(action, Poison) for action in actions)
    assert not any(isinstance(action, Record) for action in actions)


def test_agreement_with_itself_is_no_comparison_with_another_worker(alone: DispatchState) -> None:
    state, _ = deliver(alone, 1, "d")
    state, actions = deliver(state, 2, "d")
    assert Record("w", Attempt(R0, 2)) in actions
    assert state.comparisons == {}, "its first three results are compared once there is another worker"


def asked(workers: str, *opinions: Opinion, state: DispatchState | None = None) -> DispatchState:
    """Return the state in which the first of these idle workers has R0, which is compared, after these opinions."""
    state = state or DispatchState(Limits(), second_opinion=True)
    for name in workers:
        for event in (WorkerUp(0.0, name, name), Reported(0.0, name, None, 0)):
            state, _ = machine.advance(state, event)
    wanted = Wanted(0.0, ((R0, len(opinions)),), compared=frozenset({R0}), opinions={R0: opinions})
    state, _ = machine.advance(state, wanted)
    state, _ = machine.advance(state, HandOut(0.0))
    return state


def opinion(number: int, worker: str, digest: str) -> Opinion:
    return Opinion(worker, worker, Attempt(R0, number), digest)


@pytest.mark.parametrize("first", ["liar", "honest"])
def test_a_worker_that_sends_the_right_result_when_it_is_asked_again_is_outvoted(first: str) -> None:
    before = (opinion(1, "a", "false"), opinion(2, "b", "d"))
    state = asked("a", *(before if first == "liar" else before[::-1]))
    state, actions = deliver(state, 3, "d", "a")
    assert Record("a", Attempt(R0, 3)) in actions
    (found,) = [each for each in actions if isinstance(each, Outvoted)]
    assert (found.worker, found.digest) == ("a", "false")
    (aside,) = [each for each in actions if isinstance(each, SetAside)]
    assert says(aside.reason, "trajectory p.0.true.0 differs another")
    assert is_outvoted(state, "a"), "also after its result was recorded"
    check_invariants(state)


def test_no_restart_makes_two_that_differ_one_that_agrees_with_itself() -> None:
    state = asked("a", opinion(1, "a", "false"), opinion(2, "b", "d"))
    state, actions = deliver(state, 3, "false", "a")
    assert any(isinstance(action, Poison) for action in actions)
    # Nor does a restart after that end.
    opinions = (opinion(1, "a", "false"), opinion(2, "b", "d"), opinion(3, "a", "false"))
    _, actions = deliver(asked("a", *opinions), 4, "false", "a")
    assert any(isinstance(action, Poison) for action in actions)
    _, actions = deliver(asked("c", *opinions), 4, "d", "c")
    assert Record("c", Attempt(R0, 4)) in actions
    assert [each.worker for each in actions if isinstance(each, Outvoted)] == ["a"]


def test_what_an_outvoted_worker_has_sent_is_no_opinion() -> None:
    banned = DispatchState(Limits(), standings=without({}, ["a"]), second_opinion=True)
    _, actions = deliver(asked("c", opinion(1, "a", "false"), state=banned), 2, "false", "c")
    assert not any(isinstance(action, Record) for action in actions)
    state, _ = deliver(asked("c", opinion(1, "a", "false"), state=banned), 2, "d", "c")
    _, actions = deliver(state, 3, "d", "c")
    assert Record("c", Attempt(R0, 3)) in actions, "two that are left agree"


def test_an_outvoted_worker_stays_aside_whatever_fails_on_it_afterwards() -> None:
    limits, state = Limits(), asked("a")
    state = replace(state, standings=without(state.standings, ["a"]))  # in another rollout, while it has this one
    state, _ = machine.advance(state, Delivered(1.0, "a", Attempt(R0, 1), Failure("system", "it raised")))
    assert state.waiting == (R0,)
    for at in (2.0, 2.0 + limits.first_pause, 2.0 + limits.longest_pause):
        state, _ = machine.advance(state, Reported(at, "a", None, 0))
        state, actions = machine.advance(state, HandOut(at))
        assert actions == ()
    assert is_outvoted(state, "a")


# Doubts


Answer = tuple[str, str, bool]
"""Worker, digest, and whether the result is doubtful."""


def answered(workers: str, *answers: Answer) -> list[object]:
    """Return the last actions of a fleet whose workers answer R0 in this order, to whichever worker it went."""
    state, attempt, actions = DispatchState(Limits()), 0, list[object]()
    for name in workers:
        for event in (WorkerUp(0.0, name, name), Reported(0.0, name, None, 0)):
            state, _ = machine.advance(state, event)
    state, _ = machine.advance(state, Wanted(0.0, ((R0, 0),)))
    for name, digest, doubtful in answers:
        state, given = machine.advance(state, HandOut(1.0))
        ((holder, attempt),) = [(each.worker, each.attempt.number) for each in given if isinstance(each, Start)]
        assert holder == name
        delivered = Delivered(1.0, name, Attempt(R0, attempt), None, digest, doubtful=doubtful)
        state, now = machine.advance(state, delivered)
        check_invariants(state)
        actions += now
    return [each for each in actions if not isinstance(each, Acknowledge | Compared)]


def unlike(worker: str, attempt: int) -> Fail:
    return Fail(worker, Attempt(R0, attempt), UNLIKE)


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ([("a", "d", False)], [Record("a", Attempt(R0, 1))]),
        ([("a", "d", True), ("b", "d", True)], [Record("b", Attempt(R0, 2))]),
        ([("a", "d", True), ("b", "d", False)], [Record("b", Attempt(R0, 2))]),
        ([("a", "e", True), ("b", "d", False)], [unlike("a", 1), Record("b", Attempt(R0, 2))]),
        ([("a", "e", True), ("b", "d", True), ("a", "d", True)], [unlike("a", 1), Record("a", Attempt(R0, 3))]),
        ([("a", "d", True), ("b", "e", True), ("a", "d", True)], [unlike("b", 2), Record("a", Attempt(R0, 3))]),
    ],
)
def test_a_doubtful_result_counts_once_it_is_repeated_and_nobody_is_outvoted(
    answers: list[Answer], expected: list[object]
) -> None:
    assert answered("ab", *answers) == expected


def test_three_doubtful_results_that_differ_are_poison() -> None:
    *_, last = answered("ab", ("a", "d", True), ("b", "e", True), ("a", "f", True))
    assert isinstance(last, Poison)
    assert [each.attempt.number for each in last.failures] == [1, 2, 3]


def test_the_only_worker_repeats_a_doubtful_result_without_a_fresh_process() -> None:
    assert answered("a", ("a", "d", True), ("a", "d", True)) == [Record("a", Attempt(R0, 2))]


behaviours = st.sampled_from(["good", "slow", "broken", "silent", "dies", "absent"])


@pytest.mark.rest
@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2), behaviours), max_size=4), st.sets(st.integers(0, 11)), st.booleans())
def test_with_two_good_workers_no_lie_that_is_compared_is_recorded(
    others: list[tuple[int, Behaviour]], compared: set[int], liar_first: bool
) -> None:
    members = {f"w{k}": Member(f"h{host}", each) for k, (host, each) in enumerate(others)}
    members |= {name: Member(name, "good") for name in ("y", "z")}
    members = {"a" if liar_first else "zz": Member("h0", "lies"), **members}
    found = Fleet(members, 12, second_opinion=tuple(compared))
    found.run(1500)
    assert found.poison is None
    assert len(found.recorded) == 12
    assert set(found.true.values()) == {True}, "it lies from the start, and its first results are compared"


A, B, C = b"a" * 32, b"b" * 32, b"c" * 32


@pytest.mark.parametrize(
    ("one", "other", "has_all", "differs"),
    [
        ((A, B), (A, B), True, False),
        ((A, B), (A, b""), True, False),
        ((A, b""), (A, B), False, False),
        ((A, B), (A, C), False, True),
        ((A, b""), (b"", B), False, False),
        ((), (), False, True),
        ((A, B), (A,), False, True),
    ],
)
def test_batches_are_compared_rollout_by_rollout(
    one: tuple[bytes, ...], other: tuple[bytes, ...], has_all: bool, differs: bool
) -> None:
    """One that failed in a batch contradicts nothing; without the digests of each only the files can be compared."""
    own, theirs = (Opinion("w", "h", Attempt(R0, 1), digest, each=each) for digest, each in (("1", one), ("2", other)))
    assert (has_all_of(own, theirs), contradicts(own, theirs)) == (has_all, differs)
    alike = replace(theirs, digest="1")
    assert (has_all_of(own, alike), contradicts(own, alike)) == (True, False)
