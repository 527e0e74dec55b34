"""A worker that ends: it gets nothing more, and what it hands back waits for another one at once.

That counts against nobody: the reason lies in no rollout, worker or host, but in a scheduler or a person that ends the
process. So a rollout is handed back as often as workers end; from `OFTEN` times on that is reported, once; those
before a restart of the orchestrator count. The worker is `shunned` without its attempt; it never reports idle again,
and is dismissed as soon as nothing can be on the way to it.
"""

from dataclasses import replace

from .events import Acknowledge, Action, Dismiss, HandedBack, OftenHandedBack, Reported, Requeue
from .opinions import queued_again
from .state import DispatchState, Worker

OFTEN = 10
"""Times that one rollout is handed back until that is reported: if every second attempt met the end of its worker by
chance, one rollout in a thousand would be; most of the time its workers live too short for it."""


def report_leaving(state: DispatchState, event: Reported, worker: Worker) -> tuple[DispatchState, tuple[Action, ...]]:
    """Take the heartbeat of a worker that leaves and has nothing to do; it lives."""
    # With an assignment on the way it is not dismissed: it hands that back first.
    if worker.attempt is not None:
        return state, ()
    return _without_attempt(state, event, worker), (Dismiss(event.worker),)


def hand_back(state: DispatchState, event: HandedBack) -> tuple[DispatchState, tuple[Action, ...]]:
    """Take an attempt that its worker has stopped."""
    worker, rollout = state.workers.get(event.worker), event.attempt.rollout
    acknowledge = Acknowledge(event.worker, event.attempt)
    if worker is not None and worker.attempt == event.attempt:
        state = _without_attempt(state, event, worker)
    # Acknowledged all the same: the worker repeats it until it has that.
    if rollout not in state.open:
        return state, (acknowledge,)
    # In front, as after a failure; unless it waits or is simulated already, as when this is a repeat.
    state, often = _with_hand_back(state, event) if state.is_undecided(rollout) else (state, ())
    return queued_again(state, rollout), (Requeue(event.worker, event.attempt), acknowledge, *often)


def _with_hand_back(state: DispatchState, event: HandedBack) -> tuple[DispatchState, tuple[OftenHandedBack, ...]]:
    rollout = event.attempt.rollout
    known = replace(state.open[rollout], handed_back=state.open[rollout].handed_back + 1)
    state, times = replace(state, open={**state.open, rollout: known}), known.handed_back
    often = (OftenHandedBack(rollout, times, event.worker, state.host(event.worker)),) if times == OFTEN else ()
    return state, often


def _without_attempt(state: DispatchState, event: Reported | HandedBack, worker: Worker) -> DispatchState:
    leaving = replace(worker.shunned(event.at), leaving=True)
    return replace(state, workers={**state.workers, event.worker: leaving})
