"""The diagrams of the two cores are current, and show what the cores do: no more and no less."""

import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from perfbound.orchestrator.campaign import state as campaign
from perfbound.orchestrator.campaign.state import Plan
from perfbound.orchestrator.fleet.dispatch import events, machine
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.schemas.errors import IllegalEvent
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId
from tests.architecture.diagrams import FOLDER, texts
from tests.architecture.transitions import Transition, of_campaign, of_dispatch

DOCS = Path(__file__).parents[3] / "docs"
STEPS = 400_000


@pytest.mark.rest
@pytest.mark.parametrize("name", sorted(texts()))
def test_a_diagram_is_current(name: str) -> None:
    assert (FOLDER / name).read_text() == texts()[name], "run `python -m tests.architecture`"
    assert f"(images/{name})" in (DOCS / "architecture.md").read_text()


@pytest.mark.rest
def test_every_label_is_in_its_diagram() -> None:
    events = {each.event for each in of_dispatch()} - {"Unwanted"}
    assert events <= set(re.findall(r">(\w+)</text>", texts()["dispatch.svg"]))
    phases = {phase for each in of_campaign() for phase in (each.before, each.after)}
    assert phases <= set(re.findall(r">(\w+)</text>", texts()["campaign.svg"]))


# The pure machines

ROLLOUTS = [RolloutId("p", number, "true", 0) for number in range(4)]
WORKERS = ["a", "b", "c"]
FAILURES = [Failure("infrastructure", "it broke"), Failure("system", "it raised")]


def an_event(rng: random.Random, at: float) -> events.Event:
    """Return any event: false reports of workers, results that come twice, rollouts that are withdrawn."""
    worker, rollout = rng.choice(WORKERS), rng.choice(ROLLOUTS)
    attempt = Attempt(rollout, rng.randint(1, 3))
    makers: list[Callable[[], events.Event]] = [
        lambda: events.Wanted(at, ((rollout, 0),)),
        lambda: events.WorkerUp(at, worker),
        lambda: events.WorkerUp(at, worker),
        lambda: events.WorkerDown(at, worker),
        lambda: events.Reported(at, worker, rng.choice([None, attempt]), rng.randint(0, 9)),
        lambda: events.Reported(at, worker, rng.choice([None, attempt]), rng.randint(0, 9)),
        lambda: events.Delivered(at, worker, attempt, rng.choice([None, None, *FAILURES])),
        lambda: events.Tick(at),
        lambda: events.HandOut(at),
        lambda: events.RouterChanged(at, 30.0),
        lambda: events.LinkChanged(at, 30.0, rng.choice([True, True, False])),
        lambda: events.Unwanted(at, (rollout,)),
        lambda: events.Reported(at, worker, None, 0, leaving=rng.random() < 0.3),
        lambda: events.HandedBack(at, worker, attempt),
    ]
    return rng.choice(makers)()


@pytest.mark.rest
def test_the_diagram_of_dispatch_is_what_the_core_does() -> None:
    rng, at, seen = random.Random(0), 0.0, set()
    state = DispatchState(Limits(max_attempts=10**9))
    for _ in range(STEPS):
        at += rng.choice([0.1, 0.5, 5.0])
        event = an_event(rng, at)
        after, _ = machine.advance(state, event)
        for name in WORKERS:
            one, other = (each.workers[name].phase if name in each.workers else "unknown" for each in (state, after))
            if one != other:
                seen.add(Transition(one, type(event).__name__, other))
        state = after
    assert seen == of_dispatch()


@pytest.mark.rest
def test_the_diagram_of_a_test_is_what_the_core_does() -> None:
    rng, seen = random.Random(0), set()
    plan = Plan("p", window=3, max_tests=6, rollouts=(("true", 0), ("true", 1)))
    state = campaign.initial((plan,))
    for _ in range(STEPS):
        test = rng.randint(0, 5)
        events: list[campaign.Event] = [
            campaign.Proposed("p", test),
            campaign.Recorded(RolloutId("p", test, "true", rng.randint(0, 1))),
            campaign.Observed("p", test, rng.choice([None, None, "converged"])),
        ]
        event = rng.choice(events)
        try:
            after, _ = campaign.step(state, event)
        except IllegalEvent:
            continue
        for number in range(6):
            one, other = (each.problems[0].phase(number) for each in (state, after))
            if one != other:
                seen.add(Transition(one, type(event).__name__, other))
        state = campaign.initial((plan,)) if after.done else after
    assert seen == of_campaign()
