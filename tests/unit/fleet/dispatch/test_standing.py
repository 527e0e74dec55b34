"""Workers and hosts that fail: who is set aside, for how long, whose fault a failure is, and what ends a campaign."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.fleet.dispatch import machine
from perfbound.orchestrator.fleet.dispatch.events import (
    Delivered,
    EarlierFailure,
    Fail,
    HandOut,
    Poison,
    Reported,
    SetAside,
    Start,
    TakeBack,
    Wanted,
    WorkerUp,
)
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.retries import missed
from perfbound.orchestrator.fleet.dispatch.standing import Place, Standings, count_failure, last_failure, set_aside
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId
from tests.fakes.fleets import Behaviour, Fleet, Member

R0 = RolloutId("p", 0, "true", 0)
LIMITS = Limits(deadline=40.0)


def fleet(rollouts: int, limits: Limits = LIMITS, **workers: Behaviour) -> Fleet:
    """Return workers by name; the part of a name before _ is the host."""
    return Fleet({name: Member(name.split("_")[0], each) for name, each in workers.items()}, rollouts, limits)


def alike(number: int, behaviour: Behaviour) -> dict[str, Member]:
    """Return workers that behave alike, each on a host of its own."""
    return {f"w{k}": Member(f"w{k}", behaviour) for k in range(number)}


def test_a_broken_worker_is_set_aside_at_its_third_failure_in_a_row_and_costs_no_rollout() -> None:
    found = fleet(30, a="broken", b="good", c="good")
    found.run(600)
    assert (len(found.recorded), found.poison) == (30, None)
    assert set(found.recorded.values()) == {"b", "c"}
    (at, first), *_ = found.pauses
    reason = "3 rollouts in a row have failed, the last: no simulator"
    assert first == SetAside(Place("worker", "a"), 30.0, reason)
    assert at < 1
    assert found.now < 33, "two good workers need 30 s"


def test_the_pause_doubles_after_one_more_failure_and_a_success_forgives_all() -> None:
    found = fleet(300, a="broken", b="good", c="good")
    found.run(100)
    began = [(round(at), pause.seconds) for at, pause in found.pauses if isinstance(pause, SetAside)]
    assert began == [(1, 30.0), (31, 60.0), (91, 120.0)]
    assert sum(start.worker == "a" for _, start in found.starts) == 5
    found.members["a"].behaviour = "good"
    found.run(150)
    assert "a" in found.recorded.values()
    found.members["a"].behaviour = "broken"
    found.run(10)
    assert [pause.seconds for _, pause in found.pauses if isinstance(pause, SetAside)][3:] == [30.0]


def test_a_pause_does_not_grow_without_end() -> None:
    found = fleet(60, replace(LIMITS, first_pause=1.0, longest_pause=8.0), a="broken", b="good")
    found.run(60)
    pauses = [pause.seconds for _, pause in found.pauses if isinstance(pause, SetAside)]
    assert pauses[:6] == [1.0, 2.0, 4.0, 8.0, 8.0, 8.0]


def test_a_host_is_set_aside_where_others_succeed() -> None:
    found = fleet(40, h_1="good", h_2="good", k_1="good", k_2="good")
    found.run(7)
    for name in ("h_1", "h_2"):
        found.members[name].behaviour = "broken"
    found.run(60)
    assert found.poison is None
    assert len(found.recorded) == 40
    assert "h" in found.set_aside or {"h_1", "h_2"} <= set(found.set_aside)


def test_a_host_with_fresh_workers_again_and_again_is_set_aside_as_a_whole() -> None:
    """No worker has three failures of its own."""
    found = fleet(60, k="good", l="good")
    found.run(7)
    for number in range(4):
        found.members[f"h_{number}"] = Member("h", "broken")
        found.run(0.5)
        found.members[f"h_{number}"].behaviour = "absent"
        found.run(6)
    assert found.set_aside[0] == "h"


def test_one_bad_worker_is_not_its_host_s_fault() -> None:
    found = fleet(40, h_1="broken", h_2="good", k="good")
    found.run(120)
    assert set(found.set_aside) == {"h_1"}
    assert "h_2" in found.recorded.values()


def test_a_success_of_its_host_ends_the_pause_early() -> None:
    found = fleet(80, h_1="good", h_2="good", h_3="slow", k_1="good", k_2="good")
    found.run(10)
    found.members["h_1"].behaviour = found.members["h_2"].behaviour = "dies"
    found.run(11)
    assert found.set_aside == ["h"]
    found.run(20)
    assert TakeBack(Place("host", "h")) in [pause for _, pause in found.pauses], "h_3 had begun before"


@pytest.mark.parametrize("bad", ["broken", "raises", "dies", "endless"])
@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_a_system_that_fails_everywhere_ends_the_campaign_soon(bad: Behaviour, workers: int) -> None:
    found = Fleet(alike(workers, bad), 100, LIMITS)
    found.run(1000)
    assert found.poison is not None
    longest = {"broken": 5, "raises": 1, "dies": 60, "endless": 2 * LIMITS.deadline + 1}
    assert found.now <= longest[bad]


def test_a_system_that_hangs_costs_two_deadlines_not_five() -> None:
    for workers in (1, 3):
        found = Fleet(alike(workers, "endless"), 1, LIMITS)
        found.run(1000)
        assert found.poison is not None
        assert [each.failure for each in found.poison.failures] == [missed(40.0)] * 2
        assert len({each.worker for each in found.poison.failures}) == min(workers, 2)
        assert found.now <= 81


def test_a_rollout_that_kills_its_workers_is_poison_although_all_others_succeed() -> None:
    found = Fleet({f"w{k}": Member(f"h{k % 2}", "good") for k in range(6)}, 60, LIMITS, bad_rollout={5: "dies"})
    found.run(300)
    assert found.poison is not None
    assert len(found.poison.failures) == LIMITS.max_attempts
    assert found.set_aside == [], "the rollout is at fault"


def test_many_bad_machines_that_are_always_idle_do_not_use_up_the_attempts_of_a_rollout() -> None:
    """Nine of ten fail at once, while the good one is busy with its first rollout."""
    found = Fleet({**alike(9, "broken"), "z": Member("z", "slow")}, 6, LIMITS)
    found.run(400)
    assert (len(found.recorded), found.poison) == (6, None)
    assert set(found.recorded.values()) == {"z"}


def test_a_machine_on_which_the_system_raises_does_not_confirm_another_one() -> None:
    """Two of four lack a licence, and are idle all the time: the retry waits for a worker that succeeds."""
    found = fleet(60, a="good", b="good", c="good", d="good")
    found.run(5)
    found.members["a"].behaviour = found.members["b"].behaviour = "raises"
    found.run(100)
    assert (len(found.recorded), found.poison) == (60, None)


def test_the_only_worker_is_never_set_aside() -> None:
    found = fleet(20, a="broken")
    found.run(20)
    assert found.pauses == []
    assert found.poison is not None


def test_bad_workers_wait_for_a_good_one_that_returns() -> None:
    found = fleet(40, a="broken", b="good")
    found.run(11)
    found.members["b"].behaviour = "absent"
    found.run(15)
    assert found.poison is None
    found.members["b"].behaviour = "good"
    found.run(400)
    assert (len(found.recorded), found.poison) == (40, None)


def test_a_bad_worker_that_is_alone_for_long_is_tried_again() -> None:
    found = fleet(100, a="broken", b="good")
    found.run(95)
    assert [pause.seconds for _, pause in found.pauses if isinstance(pause, SetAside)][-1] == 120.0
    found.members["b"].behaviour = "absent"
    began = found.now
    found.members["a"].behaviour = "good"
    found.run(60)
    later = min(at for at, start in found.starts if at >= began and start.worker == "a")
    assert later - began <= 31, "not the rest of 120 s"
    assert TakeBack(Place("worker", "a")) in [pause for _, pause in found.pauses]


def test_a_worker_waits_for_the_last_failure_of_its_host_while_that_is_set_aside() -> None:
    standings: Standings = {}
    for at, worker in ((1.0, "h_1"), (9.0, "h_2")):
        standings = count_failure(standings, worker, "h", Attempt(R0, 1), at)
    assert last_failure(standings, "h_1", "h") == 1.0
    assert last_failure(set_aside(standings, Place("host", "h"), 9.0, LIMITS), "h_1", "h") == 9.0


def test_nothing_of_workers_that_are_gone_is_kept() -> None:
    found = fleet(100, replace(LIMITS, first_pause=1.0, longest_pause=8.0), z="good")
    for number in range(20):
        found.members = {"z": found.members["z"], f"a{number}": Member(f"a{number}", "broken")}
        found.run(2)
        found.members[f"a{number}"].behaviour = "absent"
        found.run(5)
    assert len(found.state.standings) <= 6


def test_failures_of_earlier_sessions_that_blame_the_rollout_count() -> None:
    raised = Failure("system", "it raised")
    before = EarlierFailure(Fail("a", Attempt(R0, 1), raised), "a")
    state = DispatchState(LIMITS)
    for event in (
        Wanted(0.0, ((R0, 1),), failed={R0: (before,)}),
        *(each for name in "ab" for each in (WorkerUp(0.0, name, name), Reported(0.0, name, None, 0))),
    ):
        state, _ = machine.advance(state, event)
    state, starts = machine.advance(state, HandOut(0.0))
    assert starts == (Start("b", Attempt(R0, 2)),), "another worker, on which it has not failed"
    _, actions = machine.advance(state, Delivered(1.0, "b", Attempt(R0, 2), raised))
    assert Poison(R0, (before.fail, Fail("b", Attempt(R0, 2), raised))) in actions


behaviours = st.sampled_from(["good", "slow", "broken", "silent", "dies", "absent"])


@pytest.mark.rest
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), behaviours), max_size=6), st.sampled_from([None, "raises", "endless"]))
def test_no_campaign_ends_early_while_a_good_worker_lives(
    others: list[tuple[int, Behaviour]], worst: Behaviour | None
) -> None:
    """Whatever else lives: broken, silent and dying workers in any number, and one that blames every rollout."""
    members = {f"w{k}": Member(f"h{host}", each) for k, (host, each) in enumerate(others)}
    members |= {"z": Member("good host", "good")} | ({"y": Member("h0", worst)} if worst else {})
    found = Fleet(members, 12, LIMITS)
    found.run(1500)
    assert found.poison is None
    assert len(found.recorded) == 12
