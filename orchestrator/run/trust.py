"""What the run keeps and tells of its workers and hosts, and of the trust in them."""

from collections.abc import Callable
from pathlib import Path

from ...schemas.errors import one_line
from ...schemas.facts import HANDED_BACK
from ...schemas.ids import RolloutId
from ..fleet import events
from ..fleet.opinions import FOR_GOOD, without
from ..fleet.retries import blames_rollout
from ..fleet.standing import Standings
from ..store import read
from ..store.attempts import AttemptLog
from .format import duration

MOST_NAMED = 5
"""Workers in a line."""


def note(
    action: events.SetAside
    | events.TakeBack
    | events.Compared
    | events.Outvoted
    | events.Requeue
    | events.OftenHandedBack,
    log: AttemptLog,
    print_line: Callable[[str], None],
) -> None:
    """Write what concerns a worker or host alone; inside a transaction."""
    match action:
        case events.SetAside(place, seconds, reason):
            log.set_aside(place.kind, place.name, seconds, reason)
            length = duration(seconds) if seconds < FOR_GOOD else "good"
            print_line(f"{place.kind} {place.name} is set aside for {length}: {one_line(reason)}")
        case events.Compared(worker, attempt, digest):
            log.opinion("compared", attempt, worker, digest)
        case events.Outvoted(worker, attempt, digest):
            log.opinion("outvoted", attempt, worker, digest)
        case events.Requeue(worker, attempt):
            log.ended(attempt, worker, HANDED_BACK)
        case events.OftenHandedBack(rollout, times, worker, host):
            where = f"{worker} on {one_line(host)}" if host else worker
            print_line(
                f"{rollout} was handed back {times} times, last by {where}: its workers are stopped before it ends; "
                "give them more time (--max-hours, --stop-within, the limit of the scheduler), or check that host"
            )
        case events.TakeBack(place):
            log.set_aside(place.kind, place.name, 0.0, "")


def still_aside(log: AttemptLog, print_line: Callable[[str], None]) -> Standings:
    """Return the standings of the workers that were outvoted in earlier sessions; print them in one line."""
    workers = log.outvoted()
    if workers:
        more = f" and {len(workers) - MOST_NAMED} more" if len(workers) > MOST_NAMED else ""
        names = ", ".join(workers[:MOST_NAMED]) + more
        remedy = "a worker that is restarted is compared anew"
        print_line(f"outvoted in an earlier session, and still set aside: {names}; {remedy}")
    return without({}, workers)


def failures_before(directory: Path, deadline: float) -> dict[RolloutId, tuple[events.EarlierFailure, ...]]:
    """Return the failures of earlier sessions that blame their rollouts; `deadline` of a rollout in s."""
    found: dict[RolloutId, tuple[events.EarlierFailure, ...]] = {}
    for each in read.failures(directory):
        if blames_rollout(each.failure, deadline):
            failed = events.EarlierFailure(events.Fail(each.worker, each.attempt, each.failure), each.host)
            found[each.attempt.rollout] = (*found.get(each.attempt.rollout, ()), failed)
    return found
