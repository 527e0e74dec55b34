"""The choice of workers: which of them may get a rollout, and which waiting rollout each idle one gets."""

from collections.abc import Sequence
from dataclasses import dataclass

from ....schemas.ids import WorkId
from .retries import ELSEWHERE, OVER, SAME_WORKER
from .standing import FOR_GOOD, Place, Standing, in_a_row, is_aside, last_failure
from .state import SERVING, DispatchState, Worker


def eligible(state: DispatchState, at: float, rollout: WorkId | None = None) -> list[str]:
    """Return the workers that serve and are not set aside; if all are, those whose last failure is long enough ago.

    With `rollout` only those that have its simulator.
    """
    found = _in_favour(state, at)
    return found if rollout is None else [name for name in found if state.simulates(name, rollout)]


def _in_favour(state: DispatchState, at: float) -> list[str]:
    serving = [(name, worker.host) for name, worker in state.workers.items() if worker.phase in SERVING]
    if not state.standings:
        return [name for name, _ in serving]
    found = [name for name, host in serving if not is_aside(state.standings, name, host, at)]
    if found:
        return found
    # The last good worker may only be restarting: bad ones must not use up a rollout's attempts while it is away.
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


def nearest(state: DispatchState, rollout: WorkId, at: float) -> int:
    """Return the lowest `Open.rank` of an open rollout among the workers that may try it; that of a repeat for none."""
    known = state.open[rollout]
    return min(
        (known.rank(name, state.workers[name].host) for name in eligible(state, at, rollout)), default=SAME_WORKER
    )


def is_alone(state: DispatchState, rollout: WorkId, at: float) -> bool:
    """Whether none but workers that have tried an open rollout can try it, now or soon."""
    return nearest(state, rollout, at) == SAME_WORKER and not others_may_come(state, rollout, at)


def others_may_come(state: DispatchState, rollout: WorkId, at: float) -> bool:
    """Whether an open rollout is to wait for a worker that is out of reach, or not known yet, and has not tried it."""
    known = state.open[rollout]
    blamed = known.is_blamed(state.limits.deadline)
    # A doubt is one of the system: about that, a repeat by any worker says as much as another one.
    if known.waits_until == OVER or not (blamed or any(not each.doubtful for each in known.opinions)):
        return False
    digests = {each.digest for each in known.opinions if not is_outvoted(state, each.worker)}
    # Without a dispute a worker that is alone after a restart agrees with itself, as without a restart.
    if at < state.alone_from and (blamed or len(digests) > 1):
        return True
    return any(
        _is_expected(state, worker, at)
        and state.simulates(name, rollout)
        and known.rank(name, worker.host) < SAME_WORKER
        and not is_aside(state.standings, name, worker.host, at)
        for name, worker in state.workers.items()
    )


def is_outvoted(state: DispatchState, worker: str) -> bool:
    """Whether a worker has been set aside for good."""
    return state.standings.get(Place("worker", worker), Standing()).until == FOR_GOOD


def has_others(state: DispatchState, worker: str, at: float) -> bool:
    """Whether another worker can try what a worker has tried, now or soon."""
    return any(name != worker for name in eligible(state, at)) or any(
        name != worker and _is_expected(state, other, at) and not is_aside(state.standings, name, other.host, at)
        for name, other in state.workers.items()
    )


def _is_expected(state: DispatchState, worker: Worker, at: float) -> bool:
    if worker.leaving or worker.replaced:
        return False
    # One that is lost has been removed; a `new` or `shunned` one reports with its next heartbeat, or hangs.
    reports = worker.phase in ("new", "shunned") and at < worker.started_at + state.limits.hung_after
    return worker.phase == "gone" or reports


@dataclass(frozen=True, slots=True)
class Pairs:
    """What a turn hands out, and what continues to wait."""

    found: list[tuple[str, WorkId]]
    """Idle workers with a rollout each."""
    passed: tuple[WorkId, ...]
    """Rollouts that wait for another worker than the idle ones."""
    tried: tuple[WorkId, ...]
    """Those of them that every worker which may get one has tried."""
    rest: tuple[WorkId, ...]
    """Rollouts for which no worker was left."""


def pairs(state: DispatchState, at: float) -> Pairs:
    """Choose the waiting rollouts of idle workers."""
    allowed = eligible(state, at)
    # Sorted: the order of the mapping depends on the order in which the workers came.
    free = sorted(name for name in allowed if state.workers[name].phase == "idle")
    found, left, tried, reached = list[tuple[str, WorkId]](), list[WorkId](), list[WorkId](), 0
    for rollout in state.waiting:
        if not free:
            break
        reached += 1
        worker, rank = _worker(state, rollout, free, allowed, at)
        if worker is None:
            left.append(rollout)
            tried += [rollout] if rank == SAME_WORKER else []
        else:
            free.remove(worker)
            found.append((worker, rollout))
    return Pairs(found, tuple(left), tuple(tried), state.waiting[reached:])


def _worker(
    state: DispatchState, rollout: WorkId, free: Sequence[str], allowed: Sequence[str], at: float
) -> tuple[str | None, int]:
    """Return the free worker for a rollout, None if a better one is busy or may come; and the lowest `Open.rank`."""
    known = state.open[rollout]
    if state.variants:
        free, allowed = ([name for name in each if state.simulates(name, rollout)] for each in (free, allowed))
        if not allowed:
            return None, ELSEWHERE
    if known.is_fresh:
        return (free[0] if free else None), ELSEWHERE
    hosts = {name: state.workers[name].host for name in allowed}
    ranks = {
        # The second part, because two nodes that lack a licence would confirm each other's failure.
        name: (known.rank(name, host), host not in state.proven or in_a_row(state.standings, name) > 0)
        for name, host in hosts.items()
    }
    best = min(ranks.values())
    if best[0] == SAME_WORKER and (known.is_waiting or others_may_come(state, rollout, at)):
        return None, best[0]
    # The best may be busy, and is waited for: a second failure says more the less it shares with the first.
    return next((name for name in free if ranks[name] == best), None), best[0]
