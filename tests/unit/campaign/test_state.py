"""The campaign core: its table, and the one order of proposals and observations whatever arrives when."""

import random
from collections import deque
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.campaign import state as campaign
from perfbound.orchestrator.campaign.state import (
    LEGAL,
    LEGAL_OF_PROBLEM,
    Action,
    Certify,
    Event,
    Extended,
    Observe,
    Observed,
    OpenTest,
    Phase,
    Plan,
    ProblemState,
    Propose,
    Proposed,
    Recorded,
    Simulate,
    Standing,
    State,
    Withdraw,
    assert_invariants,
    initial,
    outstanding,
    step,
    with_series,
)
from perfbound.schemas.errors import IllegalEvent
from perfbound.schemas.ids import RolloutId

PAIR = (("nominal", 0), ("true", 0))


def a_plan(problem: str = "p", window: int = 1, max_tests: int = 9) -> Plan:
    return Plan(problem, window, max_tests, PAIR)


def rollout(test: int, variant: str = "nominal", replicate: int = 0, problem: str = "p") -> RolloutId:
    return RolloutId(problem, test, variant, replicate)


def replay(plans: tuple[Plan, ...], events: list[Event]) -> State:
    state = initial(plans)
    for event in events:
        state, _ = step(state, event)
        assert_invariants(state)
    return state


# The table

HISTORY: dict[Phase, list[Event]] = {
    "absent": [],
    "running": [Proposed("p", 0)],
    "complete": [Proposed("p", 0), Recorded(rollout(0)), Recorded(rollout(0, "true"))],
    "closed": [Proposed("p", 0), Recorded(rollout(0)), Recorded(rollout(0, "true")), Observed("p", 0)],
}
EVENTS: dict[str, Event] = {
    "Proposed": Proposed("p", 0),
    "Recorded": Recorded(rollout(0)),
    "Observed": Observed("p", 0),
}


def printed_table(first: str = "phase") -> dict[tuple[str, str], str]:
    """The table at the head of the module whose first column has this name."""
    assert campaign.__doc__ is not None
    _, behind = campaign.__doc__.split(f"    {first}  ")
    text = f"    {first}  {behind}".split("\n\n")[0]
    lines = [line.split("  ") for line in text.splitlines()]
    rows = [[cell.strip() for cell in line if cell.strip()] for line in lines]
    return {(row[0], name): cell for row in rows[1:] for name, cell in zip(rows[0][1:], row[1:], strict=True)}


def test_the_printed_table_is_the_law() -> None:
    printed = printed_table()
    assert {key for key, cell in printed.items() if cell != "-"} == set(LEGAL)
    for key, phases in LEGAL.items():
        assert printed[key] in (", or ".join(phases), "(ignored)")
    assert {key for key, cell in printed.items() if cell == "(ignored)"} == {
        ("complete", "Recorded"),
        ("closed", "Recorded"),
    }


@pytest.mark.parametrize("phase", HISTORY)
@pytest.mark.parametrize("name", EVENTS)
def test_every_cell_of_the_table(phase: Phase, name: str) -> None:
    state = replay((a_plan(),), HISTORY[phase])
    assert state.problems[0].phase(0) == phase
    if (phase, name) in LEGAL:
        after, actions = step(state, EVENTS[name])
        assert_invariants(after)
        assert after.problems[0].phase(0) in LEGAL[phase, name]
        if printed_table()[phase, name] == "(ignored)":
            assert (after, actions) == (state, ())
    else:
        with pytest.raises(IllegalEvent, match=rf"not allowed: test 0 of p is {phase}"):
            step(state, EVENTS[name])
        assert state == replay((a_plan(),), HISTORY[phase])


@pytest.mark.parametrize("name", EVENTS)
def test_a_stopped_problem_proposes_and_observes_nothing_more(name: str) -> None:
    history = [*HISTORY["complete"], Proposed("p", 1), Observed("p", 0, "converged")]
    state = replay((a_plan(window=2),), history)
    assert state.done
    assert state.problems[0].phase(1) == "closed"
    if name == "Recorded":
        assert step(state, Recorded(rollout(1))) == (state, ())
        return
    for test in range(3):
        event = Proposed("p", test) if name == "Proposed" else Observed("p", test)
        with pytest.raises(IllegalEvent):
            step(state, event)


@pytest.mark.parametrize(
    ("window", "history", "event", "reason"),
    [
        (3, [Proposed("p", 0)], Proposed("p", 2), "1 proposed"),
        (1, [Proposed("p", 0)], Proposed("p", 1), "0 tests observed"),
        (
            2,
            [Proposed("p", 0), Proposed("p", 1), Recorded(rollout(1)), Recorded(rollout(1, "true"))],
            Observed("p", 1),
            "test 0 is to be observed",
        ),
        (2, HISTORY["complete"], Observed("p", 0), "a proposal is due"),
        (1, HISTORY["running"], Recorded(rollout(0, "true", 1)), "no such rollout"),
        (1, [], Proposed("q", 0), "has no problem 'q'"),
    ],
)
def test_the_rules_beyond_the_table(window: int, history: list[Event], event: Event, reason: str) -> None:
    state = replay((a_plan(window=window),), history)
    with pytest.raises(IllegalEvent, match=reason):
        step(state, event)
    assert state == replay((a_plan(window=window),), history)


def test_the_budget_ends_a_problem() -> None:
    state = replay((a_plan(max_tests=1),), HISTORY["complete"])
    state, actions = step(state, Observed("p", 0))
    assert (state.problems[0].stopped_by, actions) == ("budget", (Certify(),))
    with pytest.raises(IllegalEvent):
        step(state, Proposed("p", 1))


STANDINGS: dict[Standing, list[Event]] = {
    "going on": HISTORY["complete"][:-1],
    "spent": [*HISTORY["complete"], Observed("p", 0)],
    "answered": [*HISTORY["complete"], Observed("p", 0, "converged")],
}


def test_the_printed_table_of_problems_is_the_law() -> None:
    printed = {key: cell for key, cell in printed_table("problem").items() if cell != "-"}
    assert printed == {key: ", or ".join(after) for key, after in LEGAL_OF_PROBLEM.items()}


@pytest.mark.parametrize("standing", STANDINGS)
def test_only_a_problem_that_has_spent_its_budget_is_extended(standing: Standing) -> None:
    state = replay((a_plan(max_tests=1),), STANDINGS[standing])
    assert state.problems[0].standing == standing
    if (standing, "Extended") in LEGAL_OF_PROBLEM:
        state, actions = step(state, Extended((("p", 3),)))
        assert_invariants(state)
        assert (state.problems[0].standing, actions) == ("going on", (Propose("p", 1),))
        return
    with pytest.raises(IllegalEvent, match="not allowed"):
        step(state, Extended((("p", 3),)))


def test_every_way_a_problem_stands_after_an_observation() -> None:
    before = replay((a_plan(max_tests=2),), HISTORY["complete"])
    answered, _ = step(before, Observed("p", 0, "converged"))
    going_on, _ = step(before, Observed("p", 0))
    last = replay((a_plan(max_tests=1),), HISTORY["complete"])
    spent, _ = step(last, Observed("p", 0))
    seen = {state.problems[0].standing for state in (answered, going_on, spent)}
    assert seen == set(LEGAL_OF_PROBLEM["going on", "Observed"])


@pytest.mark.parametrize("budgets", [(), (("p", 1),), (("p", 0),), (("q", 3),), (("p", 3), ("p", 4))])
def test_an_extension_names_problems_once_and_a_larger_budget(budgets: tuple[tuple[str, int], ...]) -> None:
    state = replay((a_plan(max_tests=1),), STANDINGS["spent"])
    with pytest.raises(IllegalEvent):
        step(state, Extended(budgets))
    assert state == replay((a_plan(max_tests=1),), STANDINGS["spent"])


def test_no_problem_is_extended_before_the_last_series_has_stopped() -> None:
    state, _ = with_series(replay((a_plan(max_tests=1),), STANDINGS["spent"]), a_plan("check"))
    with pytest.raises(IllegalEvent, match="has not stopped"):
        step(state, Extended((("p", 3),)))


def test_an_extension_fills_the_window_and_leaves_answered_problems_as_they_are() -> None:
    plans = (a_plan("p", window=3, max_tests=1), a_plan("q"))
    history: list[Event] = [*STANDINGS["spent"], Proposed("q", 0)]
    history += [Recorded(rollout(0, variant, problem="q")) for variant in ("nominal", "true")]
    state = replay(plans, [*history, Observed("q", 0, "converged")])
    state, actions = step(state, Extended((("p", 5),)))
    assert actions == (Propose("p", 1),)
    for test in (1, 2, 3):
        state, actions = step(state, Proposed("p", test))
    assert not any(isinstance(action, Propose) for action in actions)
    assert state.problems[1].standing == "answered"


def test_tests_that_follow_batches_come_one_by_one_after_all_of_them() -> None:
    """The first of them is chosen by every observation before it, however few blocks there are."""
    plan = Plan("p", 3, 5, PAIR, later=(5, (("true", 0),)), batch=2, block=2, followups=4)
    state = replay((plan,), [Proposed("p", test) for test in (0, 2, 4)])
    for first in (0, 2, 4):
        for variant in ("nominal", "true"):
            state, actions = step(state, Recorded(rollout(first, variant)))
        assert actions == (Observe("p", first),)
        state, actions = step(state, Observed("p", first))
        assert_invariants(state)
    assert actions == (Propose("p", 5),)
    for test in (5, 6, 7):
        state, actions = step(state, Proposed("p", test))
        assert actions[0] == Simulate((rollout(test, "true"),))
    assert len(actions) == 1, "the window is full"
    assert outstanding(state) == (Simulate(tuple(rollout(test, "true") for test in (5, 6, 7))),)
    for test in (5, 6, 7, 8):
        state, actions = step(state, Recorded(rollout(test, "true")))
        state, actions = step(state, Observed("p", test))
        if test == 5:
            state, _ = step(state, Proposed("p", 8))
        assert_invariants(state)
    assert actions == (Certify(),)
    assert state.problems[0].stopped_by == "budget"


def test_what_still_runs_at_the_stop_is_withdrawn() -> None:
    history = [*HISTORY["complete"], Proposed("p", 1), Proposed("p", 2), Recorded(rollout(1))]
    state, actions = step(replay((a_plan(window=3),), history), Observed("p", 0, "converged"))
    assert_invariants(state)
    assert actions == (Withdraw((rollout(1, "true"), rollout(2), rollout(2, "true"))), Certify())


def test_check_finds_a_broken_state() -> None:
    good = ProblemState(a_plan(window=2, max_tests=2), 0, (OpenTest(0, frozenset()), OpenTest(1, frozenset())))
    assert_invariants(State((good,)))
    for broken in (
        replace(good, observed=1),
        replace(good, plan=a_plan(window=1)),
        replace(good, plan=a_plan(window=2, max_tests=1)),
        replace(good, open=(OpenTest(0, frozenset({rollout(1)})),)),
    ):
        with pytest.raises(AssertionError):
            assert_invariants(State((broken,)))


def test_a_gradual_window_begins_small_and_is_full_at_twice_its_size() -> None:
    plan = replace(a_plan(window=64, max_tests=200), gradual=True)
    assert [plan.window_at(test) for test in (0, 1, 4, 8, 10, 12, 100, 127, 128, 199)] == [
        4,
        4,
        4,
        4,
        5,
        6,
        50,
        63,
        64,
        64,
    ]
    assert replace(plan, window=3).window_at(0) == 3
    assert replace(plan, gradual=False).window_at(0) == 64
    state = initial((plan,))
    for test in range(4):
        state, _ = step(state, Proposed("p", test))
    with pytest.raises(IllegalEvent):
        step(state, Proposed("p", 4))


def test_a_rollout_has_one_text_form() -> None:
    assert RolloutId.parse(str(rollout(12, "true", 3))) == rollout(12, "true", 3)


# Any order of arrival


@dataclass(frozen=True)
class Course:
    """A problem, and the test whose observation satisfies the stop rule (None: the budget ends it)."""

    plan: Plan
    stop: int | None

    def expected(self) -> list[tuple[str, int, int]]:
        """(what, test, observations known at that moment), by the definition of the window."""
        last = self.plan.max_tests - 1 if self.stop is None else min(self.stop, self.plan.max_tests - 1)
        order, proposed = [], 0
        for test in range(last + 1):
            while proposed < self.plan.max_tests and proposed - self.plan.window_at(proposed) < test:
                order.append(("propose", proposed, test))
                proposed += 1
            order.append(("observe", test, test))
        return order


@dataclass
class Driver:
    """Ledger and workers as events in random order."""

    courses: dict[str, Course]
    rng: random.Random
    events: list[Event] = field(default_factory=list)
    order: dict[str, list[tuple[str, int, int]]] = field(default_factory=dict)
    wanted: set[RolloutId] = field(default_factory=set)
    asked: set[RolloutId] = field(default_factory=set)
    recorded: set[RolloutId] = field(default_factory=set)
    certified: int = 0

    def run(self) -> None:
        plans = tuple(course.plan for course in self.courses.values())
        state, pending = initial(plans), deque(outstanding(initial(plans)))
        while not state.done:
            if self.rng.random() < 0.1:
                assert replay(plans, self.events) == state
                self.wanted.clear()
                pending = deque(self._due(outstanding(state)))
            state = self._one_step(state, pending)
        while pending:
            assert self._act(pending.popleft()) is None
        assert outstanding(state) == (Certify(),)
        for late in [*self.asked]:
            assert step(state, Recorded(late)) == (state, ())

    def _one_step(self, state: State, pending: deque[Action]) -> State:
        event = self._act(pending.popleft()) if pending and self.rng.random() < 0.7 else self._arrival()
        if event is None:
            return state
        if isinstance(event, Recorded) and event.rollout in self.recorded:
            assert step(state, event) == (state, ()), "a duplicate changes nothing"
            return state
        if isinstance(event, Recorded):
            self.recorded.add(event.rollout)
        self.events.append(event)
        state, actions = step(state, event)
        assert_invariants(state)
        pending.extend(self._due(actions))
        return state

    def _due(self, actions: tuple[Action, ...]) -> tuple[Action, ...]:
        for action in actions:
            if isinstance(action, Simulate):
                assert not set(action.rollouts) & self.wanted, "asked for once"
                assert not set(action.rollouts) & self.recorded, "nothing is asked for that is there already"
        return actions

    def _arrival(self) -> Event | None:
        candidates = sorted(self.asked if self.rng.random() < 0.2 else self.wanted)
        if not candidates:
            return None
        arrived = self.rng.choice(candidates)
        self.wanted.discard(arrived)
        return Recorded(arrived)

    def _act(self, action: Action) -> Event | None:
        match action:
            case Propose(problem, test):
                self._note("propose", problem, test)
                return Proposed(problem, test)
            case Observe(problem, test):
                self._note("observe", problem, test)
                return Observed(problem, test, "converged" if test == self.courses[problem].stop else None)
            case Simulate(rollouts):
                self.wanted |= set(rollouts) - self.recorded
                self.asked |= set(rollouts)
            case Withdraw(rollouts):
                assert set(rollouts) & self.asked
                self.wanted -= set(rollouts)
            case Certify():
                self.certified += 1
        return None

    def _note(self, what: str, problem: str, test: int) -> None:
        known = sum(isinstance(event, Observed) and event.problem == problem for event in self.events)
        self.order.setdefault(problem, []).append((what, test, known))


@st.composite
def courses(draw: st.DrawFn) -> dict[str, Course]:
    found = {}
    for name in ("a", "b")[: draw(st.integers(1, 2))]:
        budget = draw(st.integers(1, 10))
        rollouts = draw(st.sampled_from([(("true", 0),), PAIR, (*PAIR, ("true", 1))]))
        stop = draw(st.none() | st.integers(0, budget - 1))
        window, gradual = draw(st.integers(1, 8)), draw(st.booleans())
        found[name] = Course(Plan(name, window, budget, rollouts, gradual=gradual), stop)
    return found


@pytest.mark.rest
@settings(max_examples=300, deadline=None)
@given(courses(), st.integers(0, 2**32))
def test_proposals_and_observations_have_one_order(found: dict[str, Course], seed: int) -> None:
    driver = Driver(found, random.Random(seed))
    driver.run()
    for name, course in found.items():
        assert driver.order[name] == course.expected()
    assert driver.certified <= 1


def test_the_window_decides_what_a_proposal_sees() -> None:
    course = Course(a_plan(window=3, max_tests=5), stop=3)
    proposals = [(test, known) for what, test, known in course.expected() if what == "propose"]
    assert proposals == [(0, 0), (1, 0), (2, 0), (3, 1), (4, 2)]
    assert course.expected()[-1] == ("observe", 3, 3)
