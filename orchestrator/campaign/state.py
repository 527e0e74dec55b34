"""The campaign machine: the tests of each problem, the order of their observations, and the end of the problem.

A pure machine: `step(state, event) -> (state, actions)`, without time, numbers and files. Each problem has a row of
tests, numbered from 0; a test goes through four phases, and this table lists every legal transition:

    phase      Proposed   Recorded                  Observed
    absent     running    -                         -
    running    -          running, or complete      -
    complete   -          (ignored)                 closed
    closed     -          (ignored)                 -

`-` is illegal: `step` raises `IllegalEvent` and nothing has changed. Three rules go beyond the table:

1. Tests are proposed and observed in their order.
2. The window is kept full: test i is proposed right after test i-window is observed, before any other observation, so
   that its z depends on the observations 0 .. i-window and never on the speed of a worker. A gradual window is small
   for the first tests, and grows with i.
3. A problem that has stopped proposes and observes nothing more; its open tests are withdrawn and count as closed.

The checks of a finished campaign (spot check, recheck) are series of tests like a problem's: `with_series` adds one
when every series before it has stopped.

A problem whose budget is spent continues when a larger one comes after every series has stopped; one whose question is
answered never does. This table lists every legal transition of a problem:

    problem    Observed                         Extended
    going on   going on, or spent, or answered  -
    spent      -                                going on
    answered   -                                -

The state contains the open tests; closed ones are a counter, so that a step costs the same at the end of a campaign.

Batches. Where a plan has `batch` > 1, every "test" above is a block: consecutive tests that are proposed, observed and
closed together, named by the first of them. Its rollouts are requested in batches, each named by its first rollout. A
batch is recorded with the rollouts in it that have failed, and the block waits for these one by one. Tests that follow
such a series, and are chosen by its outcomes, have no batches: the first comes after all of it is observed.
"""

from dataclasses import dataclass, replace
from typing import Literal

from ...schemas.errors import IllegalEvent
from ...schemas.ids import RolloutId
from ...schemas.values import StoppedBy, Verdict

Phase = Literal["absent", "running", "complete", "closed"]

LEGAL: dict[tuple[Phase, str], tuple[Phase, ...]] = {
    # Nothing else begins a test: no rollout is requested before its proposal is recorded.
    ("absent", "Proposed"): ("running",),
    ("running", "Recorded"): ("running", "complete"),
    ("complete", "Recorded"): ("complete",),
    ("complete", "Observed"): ("closed",),
    ("closed", "Recorded"): ("closed",),
}
"""(phase of the test, event) -> the phases that may follow."""
Standing = Literal["going on", "spent", "answered"]
LEGAL_OF_PROBLEM: dict[tuple[Standing, str], tuple[Standing, ...]] = {
    ("going on", "Observed"): ("going on", "spent", "answered"),
    # Not one that is answered: it ended by its own rule, and no further test decides anything.
    ("spent", "Extended"): ("going on",),
}
"""(standing of the problem, event) -> the standings that may follow."""

FIRST_WINDOW = 4
"""Of a gradual window."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The part of a problem's plan that the machine needs; fixed before its first test."""

    problem: str
    window: int
    max_tests: int
    rollouts: tuple[tuple[str, int], ...]
    """(variant, replicate) of every rollout of a test."""
    later: tuple[int, tuple[tuple[str, int], ...]] | None = None
    """A number of tests, and the rollouts of every test after them, where these have others."""
    variants: tuple[str, ...] = ()
    """The variant of the one rollout of each test, where the tests differ in it."""
    batch: int = 1
    """Rollouts in a batch at most."""
    block: int = 1
    """Tests in a block; the last one may have fewer."""
    origin: tuple[int, int] = (0, 0)
    """A block and its first test, from which on blocks are whole: the last one before an extension may be shorter."""
    followups: int = 0
    """Tests at most that follow one by one, without batches."""
    gradual: bool = False
    """Whether the window begins small, since what is kept of a rollout follows from the tests that are closed."""

    def window_at(self, block: int) -> int:
        """Return how many blocks at most are in flight with this one."""
        return min(self.window, max(FIRST_WINDOW, block // 2)) if self.gradual else self.window

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return self.origin[0] - (self.origin[1] - self.max_tests) // self.block

    def block_of(self, test: int) -> int:
        """Return the block of a test."""
        before, first = self.origin
        # An earlier one is closed: which block exactly, nothing asks any more.
        return before + (test - first) // self.block if test >= first else min(test // self.block, before - 1)

    def tests_of(self, first: int) -> range:
        """Return the tests of the block that begins with a test."""
        return range(first, min(first + self.block, self.max_tests))

    def first_of(self, block: int) -> int:
        """Return the first test of a block that is not closed."""
        return self.origin[1] + (block - self.origin[0]) * self.block

    def batches(self, first: int) -> tuple[RolloutId, ...]:
        """Return the first rollout of each batch of a block, in the order of the plan."""
        rollouts = self.rollouts_of(first)
        if self.batch > 1:
            # A batch has one variant, and where it has several tests all their replicates.
            variants = dict.fromkeys(variant for variant, _ in rollouts)
            by_variant = [[each for each in rollouts if each[0] == variant] for variant in variants]
            rollouts = tuple(rollout for each in by_variant for rollout in each[:: self.batch])
        return tuple(RolloutId(self.problem, first, variant, replicate) for variant, replicate in rollouts)

    def batch_of(self, rollout: RolloutId) -> tuple[RolloutId, int, int]:
        """Return the batch with a rollout of an open block: its first rollout, its tests, and the replicates of each.

        Of a plan without batches it is the rollout alone.
        """
        if self.batch == 1:
            return rollout, 1, 1
        first = self.first_of(self.block_of(rollout.test))
        same = [replicate for variant, replicate in self.rollouts_of(first) if variant == rollout.variant]
        place = same.index(rollout.replicate) // self.batch * self.batch
        numbers = same[place : place + self.batch]
        tests = len(self.tests_of(first))
        return RolloutId(self.problem, first, rollout.variant, numbers[0]), tests, len(numbers)

    def replicates_of(self, rollout: RolloutId) -> int:
        """Return the number of rollouts of the variant of a rollout in its test."""
        return sum(variant == rollout.variant for variant, _ in self.rollouts_of(rollout.test))

    def extended(self, max_tests: int) -> "Plan":
        """Return the plan with more tests."""
        # The next block begins where the tests before have ended, so that none of those changes.
        return replace(self, max_tests=max_tests, origin=(self.blocks, self.max_tests))

    def followed(self) -> "Plan":
        """Return the plan with the tests that follow."""
        return replace(self.extended(self.most_tests), batch=1, block=1, followups=0)

    @property
    def most_tests(self) -> int:
        """Tests at most, with those that follow."""
        return self.max_tests + self.followups

    def rollouts_of(self, test: int) -> tuple[tuple[str, int], ...]:
        """Return (variant, replicate) of every rollout of one test."""
        if self.later is not None and test >= self.later[0]:
            return self.later[1]
        return ((self.variants[test], 0),) if self.variants else self.rollouts

    def count(self, tests: int) -> int:
        """Return the number of rollouts of the first `tests` tests."""
        first, later = self.later or (tests, ())
        return min(tests, first) * len(self.rollouts) + max(tests - first, 0) * len(later)

    def located(self, number: int) -> tuple[int, int]:
        """Return the test of the rollout with this number, and its place there."""
        first, later = self.later or (self.max_tests, ())
        before = self.count(first)
        if number < before:
            return divmod(number, len(self.rollouts))
        test, place = divmod(number - before, len(later))
        return first + test, place


@dataclass(frozen=True, slots=True)
class OpenTest:
    """A test, or a block of tests, that is proposed and not yet observed; `test` is the first of them."""

    test: int
    missing: frozenset[RolloutId]

    @property
    def phase(self) -> Phase:
        """The phase of the test, as in the table."""
        return "running" if self.missing else "complete"


@dataclass(frozen=True, slots=True)
class ProblemState:
    """The open tests of a problem, the number of closed ones, and the reason of its end; or those of its blocks."""

    plan: Plan
    observed: int = 0
    open: tuple[OpenTest, ...] = ()
    stopped_by: StoppedBy | None = None

    @property
    def proposed(self) -> int:
        """Tests proposed so far, open ones included."""
        return self.observed + len(self.open)

    @property
    def standing(self) -> Standing:
        """The standing of the problem, as in the second table."""
        if self.stopped_by is None:
            return "going on"
        return "spent" if self.stopped_by == "budget" else "answered"

    @property
    def may_propose(self) -> bool:
        """Whether the next test may be proposed from the observations so far."""
        # Rule 2: a test in flight keeps its place in the window until it is observed, not until it is complete.
        room = self.proposed < min(self.observed + self.plan.window_at(self.proposed), self.plan.blocks)
        return self.stopped_by is None and room

    def phase(self, test: int) -> Phase:
        """Return the phase of one test."""
        block = self.plan.block_of(test)
        # Rule 3: withdrawn tests count as closed, so that a rollout that arrives late is ignored.
        if block < self.observed or (self.stopped_by is not None and block < self.proposed):
            return "closed"
        return self.open[block - self.observed].phase if block < self.proposed else "absent"


@dataclass(frozen=True, slots=True)
class State:
    """The campaign."""

    problems: tuple[ProblemState, ...]

    @property
    def done(self) -> bool:
        """Whether every problem has stopped."""
        return all(problem.stopped_by is not None for problem in self.problems)


@dataclass(frozen=True, slots=True)
class Proposed:
    """The next test of a problem has its z."""

    problem: str
    test: int


@dataclass(frozen=True, slots=True)
class Recorded:
    """A rollout's trajectory is durable, or those of a batch but for the `failed` ones."""

    rollout: RolloutId
    failed: tuple[RolloutId, ...] = ()


@dataclass(frozen=True, slots=True)
class Observed:
    """A test has its y; `verdict` is the reason why the method ends the problem here, if it does."""

    problem: str
    test: int
    verdict: Verdict | None = None


@dataclass(frozen=True, slots=True)
class Extended:
    """These problems have a larger budget: (name, tests at most)."""

    budgets: tuple[tuple[str, int], ...]


Event = Proposed | Recorded | Observed | Extended


@dataclass(frozen=True, slots=True)
class Propose:
    """Choose z of this test from the observations so far."""

    problem: str
    test: int


@dataclass(frozen=True, slots=True)
class Simulate:
    """Simulate these rollouts."""

    rollouts: tuple[RolloutId, ...]


@dataclass(frozen=True, slots=True)
class Observe:
    """Turn the trajectories of this test into y."""

    problem: str
    test: int


@dataclass(frozen=True, slots=True)
class Withdraw:
    """These rollouts are no longer needed."""

    rollouts: tuple[RolloutId, ...]


@dataclass(frozen=True, slots=True)
class Certify:
    """Every problem has stopped."""


Action = Propose | Simulate | Observe | Withdraw | Certify


def initial(plans: tuple[Plan, ...]) -> State:
    """Return the campaign before its first event."""
    return State(tuple(ProblemState(plan) for plan in plans))


def step(state: State, event: Event) -> tuple[State, tuple[Action, ...]]:
    """Apply one event.

    Raises:
        IllegalEvent: the table or a rule does not allow it; `state` is unchanged and stays valid.

    """
    if isinstance(event, Extended):
        return _extend(state, event)
    name, test = (event.rollout[:2]) if isinstance(event, Recorded) else (event.problem, event.test)
    index = _index(state, name)
    problem = state.problems[index]
    phase = problem.phase(test)
    if (phase, type(event).__name__) not in LEGAL:
        raise IllegalEvent(f"{event} is not allowed: test {test} of {name} is {phase}")
    if isinstance(event, Proposed):
        after, actions = _propose(problem, event)
    elif isinstance(event, Recorded):
        after, actions = _record(problem, event)
    else:
        after, actions = _observe(problem, event)
    problems = (*state.problems[:index], after, *state.problems[index + 1 :])
    state = State(problems)
    # Only an observation ends a problem: a late rollout of a finished campaign causes no second certificate.
    return state, (*actions, Certify()) if isinstance(event, Observed) and state.done else actions


def with_series(state: State, plan: Plan) -> tuple[State, tuple[Action, ...]]:
    """Add a series of tests to a campaign in which every series has stopped.

    Raises:
        IllegalEvent: a series has not stopped, or has this name.

    """
    if not state.done or any(plan.problem == each.plan.problem for each in state.problems):
        raise IllegalEvent(f"{plan.problem} is not allowed now: it comes once, after everything before it has stopped")
    problem = ProblemState(plan)
    return State((*state.problems, problem)), _next(problem)


def _extend(state: State, event: Extended) -> tuple[State, tuple[Action, ...]]:
    # Not before the closing checks have ended: what they found belongs to the bounds that they tested.
    if not state.done or not event.budgets:
        raise IllegalEvent(f"{event} is not allowed: a series has not stopped, or no problem is named")
    problems = list(state.problems)
    for name, max_tests in event.budgets:
        index = _index(state, name)
        problem = problems[index]
        if (problem.standing, "Extended") not in LEGAL_OF_PROBLEM:
            raise IllegalEvent(f"{event} is not allowed: {name} is {problem.standing}")
        if max_tests <= problem.plan.max_tests:
            raise IllegalEvent(f"{event} is not allowed: {name} had {problem.plan.max_tests} tests")
        problems[index] = replace(problem, plan=problem.plan.extended(max_tests), stopped_by=None)
    extended = State(tuple(problems))
    return extended, outstanding(extended)


def outstanding(state: State) -> tuple[Action, ...]:
    """Return every action that is due: the first ones of a campaign, and those after a restart."""
    if state.done:
        return (Certify(),)
    return tuple(action for problem in state.problems for action in _due(problem))


def _due(problem: ProblemState) -> tuple[Action, ...]:
    if problem.stopped_by is not None:
        return ()
    # A restart loses every assignment, never a recorded rollout: only the missing ones are simulated.
    missing = tuple(rollout for test in problem.open for rollout in _missing(problem.plan, test))
    simulate = (Simulate(missing),) if missing else ()
    return (*simulate, *_next(problem))


def _propose(problem: ProblemState, event: Proposed) -> tuple[ProblemState, tuple[Action, ...]]:
    # Rules 1 to 3: the next number, room in the window and the budget, no stop before.
    if event.test != problem.plan.first_of(problem.proposed) or not problem.may_propose:
        raise IllegalEvent(f"{event} is not allowed: {problem.observed} tests observed, {problem.proposed} proposed")
    batches = problem.plan.batches(event.test)
    problem = replace(problem, open=(*problem.open, OpenTest(event.test, frozenset(batches))))
    return problem, (Simulate(batches), *_next(problem))


def _record(problem: ProblemState, event: Recorded) -> tuple[ProblemState, tuple[Action, ...]]:
    test = event.rollout.test
    if (event.rollout.variant, event.rollout.replicate) not in problem.plan.rollouts_of(test):
        raise IllegalEvent(f"{event} is not allowed: test {test} has no such rollout")
    # At-least-once delivery: a rollout of a complete or closed test may arrive again, and changes nothing.
    if problem.phase(test) != "running":
        return problem, ()
    position = problem.plan.block_of(test) - problem.observed
    before = problem.open[position]
    after = OpenTest(before.test, (before.missing - {event.rollout}).union(event.failed))
    problem = replace(problem, open=(*problem.open[:position], after, *problem.open[position + 1 :]))
    retries = (Simulate(event.failed),) if event.failed else ()
    # Rule 1: only the oldest open test may be observed; a younger one waits for its turn.
    completed = position == 0 and before.missing and not after.missing
    return problem, (*retries, *_next(problem)) if completed and not problem.may_propose else retries


def _observe(problem: ProblemState, event: Observed) -> tuple[ProblemState, tuple[Action, ...]]:
    # Rule 2: a proposal that is due comes first, or z would depend on one observation more than in another run.
    if event.test != (first := problem.open[0].test) or problem.may_propose:
        due = f"test {first} is to be observed" if event.test != first else "a proposal is due"
        raise IllegalEvent(f"{event} is not allowed: {due} before it")
    problem = replace(problem, observed=problem.observed + 1, open=problem.open[1:])
    if problem.plan.followups and problem.observed == problem.plan.blocks:
        problem = replace(problem, plan=problem.plan.followed())
    # The verdict comes before the budget: a bound that converges with the last test has converged.
    if event.verdict is not None or problem.observed >= problem.plan.blocks:
        stopped = replace(problem, stopped_by=event.verdict or "budget")
        left = tuple(rollout for test in problem.open for rollout in _missing(problem.plan, test))
        return stopped, (Withdraw(left),) if left else ()
    return problem, _next(problem)


def _next(problem: ProblemState) -> tuple[Action, ...]:
    """Return the one thing that a problem waits for: a proposal, else the observation of its oldest test."""
    # The order of rule 2.
    if problem.may_propose:
        return (Propose(problem.plan.problem, problem.plan.first_of(problem.proposed)),)
    if problem.open and not problem.open[0].missing:
        return (Observe(problem.plan.problem, problem.open[0].test),)
    return ()


def _missing(plan: Plan, test: OpenTest) -> tuple[RolloutId, ...]:
    # In the order of the plan: the order of a set differs from run to run.
    order = {rollout: place for place, rollout in enumerate(plan.batches(test.test))}
    return tuple(sorted(test.missing, key=lambda rollout: (order.get(rollout, len(order)), rollout)))


def plan_of(state: State, name: str) -> Plan:
    """Return the plan of a problem or a check, with its extensions."""
    return state.problems[_index(state, name)].plan


def _index(state: State, name: str) -> int:
    for index, problem in enumerate(state.problems):
        if problem.plan.problem == name:
            return index
    raise IllegalEvent(f"the campaign has no problem {name!r}")


def assert_invariants(state: State) -> None:
    """Assert the invariants of the state; tests call it after every step."""
    for problem in state.problems:
        plan = problem.plan
        numbers = [plan.block_of(test.test) for test in problem.open]
        assert numbers == list(range(problem.observed, problem.proposed)), "open tests are consecutive"
        assert [test.test for test in problem.open] == list(map(plan.first_of, numbers)), "named by their first tests"
        assert len(problem.open) <= problem.plan.window, "no more tests in flight than the window"
        assert problem.proposed <= plan.blocks, "no more tests than the budget"
        for test in problem.open:
            planned = set(plan.batches(test.test))
            assert all(each in planned or plan.batch_of(each)[0] in planned for each in test.missing), "planned ones"
