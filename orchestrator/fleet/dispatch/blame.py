"""The blame for a failed attempt: its rollout's, its worker's or its host's, by the rules of `standing`."""

from collections.abc import Sequence
from dataclasses import replace

from ....schemas.ids import Attempt
from . import standing
from .choice import others_in_good_standing
from .events import Fail, SetAside, TakeBack
from .standing import Place
from .state import DispatchState


def charge(state: DispatchState, failed: Fail, at: float) -> tuple[DispatchState, tuple[SetAside, ...]]:
    """Count a failure against its worker and host, and set one of them aside if it is due and others do the work."""
    name, limits, host = failed.worker, state.limits, state.host(failed.worker)
    before = standing.is_aside(state.standings, name, host, at)
    state = replace(state, standings=standing.count_failure(state.standings, name, host, failed.attempt, at))
    if before:  # its host was set aside while it had an attempt
        return _excused(state, frozenset({failed.attempt})), ()
    for place in standing.due(state.standings, name, host, limits):
        other = host if place.kind == "host" else None
        # Where nobody else does well the system may be at fault: the failure then counts against its rollout.
        if others_in_good_standing(state, at, worker=name, host=other):
            found = state.standings[place]
            state = replace(state, standings=standing.set_aside(state.standings, place, at, limits))
            reason = f"{found.failures} rollouts in a row have failed, the last: {failed.failure.reason}"
            aside = SetAside(place, standing.pause(found.pauses, limits), reason)
            # The failures before it as well: what set the place aside was the cause of all of them.
            return _excused(state, found.attempts), (aside,)
    return state, ()


def clear(state: DispatchState, worker: str, at: float) -> tuple[DispatchState, tuple[TakeBack, ...]]:
    """Count a recorded rollout in favour of its worker and host."""
    host = state.host(worker)
    standings, back = standing.count_success(state.standings, worker, host, at)
    return replace(state, standings=standings, proven=state.proven | {host}), tuple(map(TakeBack, back))


def take_back(state: DispatchState, workers: Sequence[str], at: float) -> tuple[DispatchState, tuple[TakeBack, ...]]:
    """End the pauses of workers that get a rollout although they are set aside: there is no other one."""
    actions: list[TakeBack] = []
    for name in workers if state.standings else ():
        standings, back = standing.resume_early(state.standings, name, state.host(name), at)
        state = replace(state, standings=standings)
        actions += map(TakeBack, back)
    return state, tuple(actions)


def forget_past(state: DispatchState, at: float) -> DispatchState:
    """Drop failures that are long past, of workers and hosts that are gone."""
    if not state.standings:
        return state
    places = {Place("worker", name) for name in state.workers}
    places |= {Place("host", worker.host) for worker in state.workers.values()}
    return replace(state, standings=standing.recent(state.standings, places, at, state.limits))


def _excused(state: DispatchState, attempts: frozenset[Attempt]) -> DispatchState:
    """Count these failed attempts no longer against their rollouts."""
    opened = dict(state.open)
    for attempt in attempts:
        if (known := opened.get(attempt.rollout)) is not None:
            opened[attempt.rollout] = replace(known, excused=known.excused | {attempt})
    return replace(state, open=opened)
