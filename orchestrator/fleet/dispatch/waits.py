"""Waits: of a rollout for a worker that has not tried it, before one repeats it that has; and for a gone worker.

Such a repeat is the last resort: it is no majority, and a second failure of one worker says little. So a rollout that
is compared, or that a failure blames, waits while another worker is gone and not lost yet, or has yet to report. If its
results differ, or a failure blames it, it also waits for workers that may come after a restart (`alone_from`). All
other rollouts continue. `HandOut` begins a wait. `Tick` ends it, as soon as nobody is expected any more, at the latest
after `others_within` s in which a worker could have repeated the rollout. The next worker for it is then given up once,
so that a local one is replaced by a fresh process.
"""

from collections.abc import Sequence
from dataclasses import replace

from ....schemas.ids import Attempt, WorkId
from .choice import eligible, nearest, others_may_come, pairs
from .events import AwaitOther, GiveUp, LinkChanged, RouterChanged
from .retries import NOT_YET, OVER, SAME_WORKER, Open
from .state import DispatchState, Worker

Pair = tuple[str, WorkId]


def hand_out(state: DispatchState, at: float) -> tuple[DispatchState, list[Pair], tuple[AwaitOther | GiveUp, ...]]:
    """Choose idle workers with a waiting rollout each; all other rollouts continue to wait."""
    chosen = pairs(state, at)
    last = [each for each in chosen.found if _is_last_resort(state, *each)]
    kept = [rollout for _, rollout in last]
    state = replace(state, waiting=(*kept, *chosen.passed, *chosen.rest))
    for rollout in kept:
        state = _with(state, rollout, replace(state.open[rollout], renewed=True))
    state, begun = _begin_waits(state, chosen.tried, at)
    return state, [each for each in chosen.found if each not in last], (*begun, *(GiveUp(name) for name, _ in last))


def given(known: Open, attempt: Attempt) -> Open:
    """Return an open rollout that a worker gets: its wait, if it is not over, has been of use."""
    return replace(known, attempts=attempt.number, waits_until=NOT_YET if known.is_waiting else known.waits_until)


def end_waits(state: DispatchState, at: float) -> DispatchState:
    """End the waits that are over."""
    waiting = [each for each in state.waiting if state.open[each].is_waiting]
    if not waiting:
        return state
    is_served = bool(eligible(state, at))
    for rollout in waiting:
        known = state.open[rollout]
        if not is_served:  # nobody could repeat it, and those that have not tried it may be the last to return
            state = _with(state, rollout, replace(known, waits_until=at + state.limits.others_within))
        elif nearest(state, rollout, at) == SAME_WORKER and not (
            at < known.waits_until and others_may_come(state, rollout, at)
        ):
            state = _with(state, rollout, replace(known, waits_until=OVER))
    return state


def _begin_waits(
    state: DispatchState, tried: Sequence[WorkId], at: float
) -> tuple[DispatchState, tuple[AwaitOther, ...]]:
    """Begin the waits of those rollouts that none but the same workers can try for now; report the first one."""
    found = [each for each in tried if not state.open[each].is_waiting and others_may_come(state, each, at)]
    if not found:
        return state, ()
    seconds = state.limits.others_within
    # One line: when a router goes, hundreds may begin to wait at once.
    others = any(each.is_waiting for each in state.open.values())
    for rollout in found:
        state = _with(state, rollout, replace(state.open[rollout], waits_until=at + seconds))
    return state, () if others else (AwaitOther(found[0], seconds),)


def _is_last_resort(state: DispatchState, worker: str, rollout: WorkId) -> bool:
    """Whether a worker repeats a rollout for which no other one has come, and has not been given up for that."""
    known = state.open[rollout]
    is_due = known.waits_until == OVER and not known.renewed
    return is_due and known.rank(worker, state.host(worker)) == SAME_WORKER


def _with(state: DispatchState, rollout: WorkId, known: Open) -> DispatchState:
    return replace(state, open={**state.open, rollout: known})


# A worker that is gone, and a router that comes or goes. A router that dies takes the tokens of all workers behind it
# along, and those return with it. So for `grace` s after a router has appeared or disappeared, a gone worker has these
# `grace` s, and not only `lost_after` s. While the orchestrator's own link is down nobody is lost: no other worker
# could be given the rollout, and none is heard.


def router_changed(state: DispatchState, event: RouterChanged) -> DispatchState:
    """Have patience with gone workers from now on."""
    # From this change alone: a router that is taken out of service must not keep the long limit on for good.
    return replace(state, grace=event.grace, patient_until=event.at + event.grace)


def link_changed(state: DispatchState, event: LinkChanged) -> DispatchState:
    """Stop the clock of gone workers while the link is down; it begins anew when the link is there again."""
    if not event.up:
        return replace(state, linked=False)
    return replace(state, linked=True, linked_at=event.at, grace=event.grace, patient_until=event.at + event.grace)


def lost_after(state: DispatchState, at: float) -> float:
    """Return the seconds after which a gone worker is lost."""
    usual = state.limits.lost_after
    return max(usual, state.grace) if at < state.patient_until else usual


def is_lost(state: DispatchState, worker: Worker, at: float) -> bool:
    """Whether a gone worker is given up."""
    # Without a link every token is missing, and after it workers need their whole time to be heard again.
    return state.linked and at - max(worker.gone_at, state.linked_at) >= lost_after(state, at)


def away(state: DispatchState, worker: Worker, at: float) -> float:
    """Return the seconds that do not count against the deadline of a worker that is back.

    Its rollout may have ended meanwhile, and its result be the next message. Only what routers explain is granted: a
    worker that withdraws its token again and again shall not escape its deadline.
    """
    return at - worker.gone_at if at < state.patient_until else 0.0
