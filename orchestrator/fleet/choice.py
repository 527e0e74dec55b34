"""The choice of workers: which of them may get a rollout, and which waiting rollout each idle one gets."""

from collections.abc import Sequence

from ...schemas.ids import RolloutId
from .retries import SAME_WORKER
from .standing import in_a_row, is_aside, last_failure
from .state import SERVING, DispatchState


def eligible(state: DispatchState, at: float) -> list[str]:
    """Return the workers that serve and are not set aside; if all are, those whose last failure is long enough ago."""
    serving = [(name, worker.host) for name, worker in state.workers.items() if worker.phase in SERVING]
    if not state.standings:
        return [name for name, _ in serving]
    found = [name for name, host in serving if not is_aside(state.standings, name, host, at)]
    if found:
        return found
    patience = state.limits.first_pause
    return [name for name, host in serving if at >= last_failure(state.standings, name, host) + patience]


def out_of_favour(state: DispatchState, at: float) -> list[str]:
    """Return the workers that are set aside."""
    if not state.standings:
        return []
    return [name for name, worker in state.workers.items() if is_aside(state.standings, name, worker.host, at)]


def others_in_good_standing(state: DispatchState, at: float, *, worker: str, host: str | None = None) -> bool:
    """Whether another worker, also of another host than `host`, serves well enough to be relied on."""
    return any(
        other.phase in SERVING
        and name != worker
        and other.host != host
        and in_a_row(state.standings, name) < state.limits.in_a_row
        and not is_aside(state.standings, name, other.host, at)
        for name, other in state.workers.items()
    )


def nearest(state: DispatchState, rollout: RolloutId, at: float) -> int:
    """Return the lowest `Open.rank` of an open rollout among the workers that may try it; that of a repeat for none."""
    known = state.open[rollout]
    return min((known.rank(name, state.workers[name].host) for name in eligible(state, at)), default=SAME_WORKER)


def pairs(state: DispatchState, at: float) -> tuple[list[tuple[str, RolloutId]], tuple[RolloutId, ...]]:
    """Return idle workers with a waiting rollout each, and the rollouts that continue to wait."""
    allowed = eligible(state, at)
    # Sorted: the order of the mapping depends on the order in which the workers came.
    free = sorted(name for name in allowed if state.workers[name].phase == "idle")
    found, left, reached = list[tuple[str, RolloutId]](), list[RolloutId](), 0
    for rollout in state.waiting:
        if not free:
            break
        reached += 1
        worker = _worker(state, rollout, free, allowed)
        if worker is None:
            left.append(rollout)
        else:
            free.remove(worker)
            found.append((worker, rollout))
    return found, (*left, *state.waiting[reached:])


def _worker(state: DispatchState, rollout: RolloutId, free: Sequence[str], allowed: Sequence[str]) -> str | None:
    """Return the free worker for a rollout; None if a better one is busy."""
    known = state.open[rollout]
    if known.is_fresh:
        return free[0]
    hosts = {name: state.workers[name].host for name in allowed}
    ranks = {
        name: (known.rank(name, host), host not in state.proven or in_a_row(state.standings, name) > 0)
        for name, host in hosts.items()
    }
    best = min(ranks.values())
    return next((name for name in free if ranks[name] == best), None)
