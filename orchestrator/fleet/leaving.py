"""A worker that ends: it gets nothing more, and what it hands back waits for another one at once.

That counts against nobody: the reason lies in no rollout, worker or host, but in a scheduler or a person that ends the
process. The worker is `shunned` without its attempt; it never reports idle again, and is dismissed as soon as nothing
can be on the way to it.
"""

from dataclasses import replace

from .events import Acknowledge, Action, Dismiss, HandedBack, Reported, Requeue
from .opinions import queued_again
from .state import DispatchState, Worker


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
    if rollout not in state.open:
        return state, (acknowledge,)
    # In front, as after a failure; unless it waits or is simulated already, as when this is a repeat.
    return queued_again(state, rollout), (Requeue(event.worker, event.attempt), acknowledge)


def _without_attempt(state: DispatchState, event: Reported | HandedBack, worker: Worker) -> DispatchState:
    return replace(state, workers={**state.workers, event.worker: worker.shunned(event.at)})
