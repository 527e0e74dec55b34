"""What the run keeps and tells of its workers and hosts, and of the trust in them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...schemas.errors import one_line
from ...schemas.ids import WorkId
from ...schemas.result.facts import HANDED_BACK
from ..certificate.words.format import duration
from ..fleet.dispatch import events
from ..fleet.dispatch.opinions import without
from ..fleet.dispatch.retries import blames_rollout
from ..fleet.dispatch.standing import FOR_GOOD, Standings
from ..store import read
from ..store.attempts import AttemptLog
from ..store.journal import Journal

MOST_NAMED = 5
"""Workers in a line."""


def note(
    action: events.SetAside
    | events.TakeBack
    | events.Compared
    | events.Outvoted
    | events.Requeue
    | events.OftenHandedBack
    | events.AwaitOther,
    log: AttemptLog,
    print_line: Callable[[str], None],
) -> None:
    """Write what concerns a worker or host alone; inside a transaction."""
    match action:
        case events.SetAside(place, seconds, reason):
            log.set_aside(place.kind, place.name, seconds, reason)
            length = duration(seconds) if seconds < FOR_GOOD else "good"
            print_line(f"{place.kind} {place.name} is set aside for {length}: {one_line(reason)}")
        case events.Compared(worker, attempt, digest, each):
            log.opinion("compared", attempt, worker, digest, each)
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
        case events.AwaitOther(rollout, seconds):
            print_line(
                f"{rollout} waits at most {duration(seconds)} for another worker, since those that are here have tried "
                "it; all other rollouts continue"
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


@dataclass(frozen=True, slots=True)
class Earlier:
    """What rollouts had before a restart: attempts, failures that count, what was compared, hand-backs."""

    attempts: Mapping[WorkId, int]
    failed: Mapping[WorkId, tuple[events.EarlierFailure, ...]]
    opinions: Mapping[WorkId, tuple[events.Opinion, ...]]
    handed_back: Mapping[WorkId, int]
    """How often workers that were stopped gave them back."""

    def wanted(
        self, at: float, rollouts: Sequence[WorkId], avoid: Mapping[WorkId, str], compared: frozenset[WorkId]
    ) -> events.Wanted:
        """Return the event that wants rollouts, with what they had before; its arguments are fields of that."""
        numbered = tuple((each, self.attempts.get(each, 0)) for each in rollouts)
        return events.Wanted(at, numbered, avoid, compared, self.failed, self.opinions, self.handed_back)


NOTHING_BEFORE = Earlier({}, {}, {}, {})


def earlier(journal: Journal, rollouts: Collection[WorkId], deadline: float) -> Earlier:
    """Return what these rollouts had before; `deadline` of a rollout in s, inside a transaction."""
    # Without second opinions nothing but a doubt is compared.
    doubtful = not journal.header.config.second_opinion
    return Earlier(
        read.attempts(journal.directory),
        _failures_before(journal.directory, deadline),
        _opinions_before(journal.attempts, rollouts, doubtful=doubtful),
        read.hand_backs(journal.directory),
    )


def _failures_before(directory: Path, deadline: float) -> dict[WorkId, tuple[events.EarlierFailure, ...]]:
    """Return the failures of earlier sessions that blame their rollouts; `deadline` of a rollout in s."""
    found: dict[WorkId, tuple[events.EarlierFailure, ...]] = {}
    for each in read.failures(directory):
        if blames_rollout(each.failure, deadline):
            failed = events.EarlierFailure(events.Fail(each.worker, each.attempt, each.failure), each.host)
            found[each.attempt.rollout] = (*found.get(each.attempt.rollout, ()), failed)
    return found


def _opinions_before(
    log: AttemptLog, rollouts: Collection[WorkId], *, doubtful: bool
) -> dict[WorkId, tuple[events.Opinion, ...]]:
    """Return the results of these rollouts that have been compared, with `doubtful` for a doubt alone."""
    found: dict[WorkId, tuple[events.Opinion, ...]] = {}
    for each in log.compared(frozenset(rollouts)):
        rollout = each.attempt.rollout
        opinion = events.Opinion(each.worker, each.host, each.attempt, each.sha256, doubtful=doubtful, each=each.each)
        found[rollout] = (*found.get(rollout, ()), opinion)
    return found


def doubted(journal: Journal) -> tuple[list[WorkId], list[WorkId]]:
    """Return the rollouts on which two workers differ, and those of outvoted workers; none without second opinions."""
    if not journal.header.config.second_opinion:
        return [], []
    return journal.attempts.disputed(), journal.attempts.suspects()
