"""Routers between orchestrator and workers: how long a worker may be gone when they come and go.

A router that dies takes the tokens of all workers behind it along, and those return with it. So for `grace` s after
a router has appeared or disappeared, a gone worker has these `grace` s, and not only `lost_after` s. While the
orchestrator's own link is down nobody is lost: no other worker could be given the rollout, and none is heard.
"""

from dataclasses import replace

from .events import LinkChanged, RouterChanged
from .state import DispatchState, Worker


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
