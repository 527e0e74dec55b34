"""Standing of workers and hosts: failures in a row, and the pauses for which a place is set aside.

A *place* is a worker or a host. One that is set aside gets no rollout, but its results still count. The rules:

- A worker is set aside when three rollouts in a row have failed on it. Repeated failures of one rollout count once: it
  is that rollout which may be at fault.
- A host is set aside if three rollouts in a row have failed on its workers, on at least two of them, and the other
  hosts have recorded three rollouts since the first failure. Without that contrast the system may be at fault, and
  with one worker it is the worker.
- The pause doubles each time, and begins anew after a success. A success also ends the pause: it may come from an
  attempt that a worker of a host had before. After a pause one more failure is enough.
- **Nothing is set aside unless another worker is left in good standing**, which means that it serves, is not set
  aside and has failed in fewer than three rollouts in a row (for a host: a worker of another host). Therefore the only
  worker of a campaign is never set aside, and neither is the last one of several.
- Failures that lead to a pause are the place's, and do not count against their rollouts; all others do. A system that
  fails everywhere brings one worker after another to its third failure. From then on no worker is in good standing,
  each failure counts, and the campaign ends with a poisoned rollout: after three failures per worker, which happen
  side by side, and `max_attempts` more. Failures of the system itself need two attempts, as they do without all this.
- If all that serve are set aside, the last good worker has left. They get rollouts again `first_pause` s after their
  last failure, however long their pauses are: long enough for a worker that is restarted or disconnected to return
  before bad ones use up the attempts of a rollout, and short enough not to stall a campaign.
- Places without a worker are forgotten `longest_pause` s after their last failure, so that memory does not grow.
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from ....schemas.ids import Attempt
from .limits import Limits

LONG_AGO = float("-inf")
FOR_GOOD = float("inf")
"""The length of a pause that nothing ends."""


class Place(NamedTuple):
    """A worker or a host, by name."""

    kind: Literal["worker", "host"]
    name: str


@dataclass(frozen=True, slots=True)
class Standing:
    """Failures of a place since its last success."""

    failures: int = 0
    """Rollouts that failed, each once, or once more after a pause."""
    attempts: frozenset[Attempt] = frozenset()
    """Those of the failures that count against their rollouts so far."""
    workers: frozenset[str] = frozenset()
    elsewhere: int = 0
    """Rollouts that other hosts have recorded since the first failure; of a host alone."""
    last: float = LONG_AGO
    """Time of the last failure."""
    pauses: int = 0
    until: float = LONG_AGO
    """End of the pause."""


Standings = Mapping[Place, Standing]


def is_aside(standings: Standings, worker: str, host: str, at: float) -> bool:
    """Whether a worker gets nothing, for its own failures or for those of its host."""
    return any(at < standings[place].until for place in _places(worker, host) if place in standings)


def last_failure(standings: Standings, worker: str, host: str) -> float:
    """Return the time of the last failure of a worker, or of its host while that one is set aside."""
    own, shared = (standings.get(place, Standing()) for place in _places(worker, host))
    return max(own.last, shared.last) if shared.pauses else own.last


def in_a_row(standings: Standings, worker: str) -> int:
    """Return the failures of a worker since its last success."""
    return standings.get(Place("worker", worker), Standing()).failures


def count_failure(standings: Standings, worker: str, host: str, attempt: Attempt, at: float) -> Standings:
    """Add a failed attempt to its worker and to its host."""
    found = dict(standings)
    for place in _places(worker, host):
        old = found.get(place, Standing())
        # A rollout that kills every worker must not make all of them suspects.
        repeated = any(each.rollout == attempt.rollout for each in old.attempts)
        found[place] = replace(
            old,
            failures=old.failures + (not repeated),
            attempts=old.attempts | {attempt},
            workers=old.workers | {worker},
            last=max(old.last, at),  # one that is set aside for good stays so
        )
    return found


def count_success(standings: Standings, worker: str, host: str, at: float) -> tuple[Standings, tuple[Place, ...]]:
    """Forget the failures of a worker and of its host; return the places whose pause ends early by it, too."""
    if not standings:
        return standings, ()
    places = _places(worker, host)
    back = tuple(place for place in places if place in standings and at < standings[place].until < FOR_GOOD)
    found = {
        place: replace(old, elsewhere=old.elsewhere + 1) if place.kind == "host" else old
        for place, old in standings.items()
        if place not in places or old.until == FOR_GOOD
    }
    return found, back


def due(standings: Standings, worker: str, host: str, limits: Limits) -> tuple[Place, ...]:
    """Return the places that a failure may set aside, the host of the worker first."""
    own, shared = (standings.get(place, Standing()) for place in _places(worker, host))
    contrast = len(shared.workers) > 1 and shared.elsewhere >= limits.in_a_row
    # No contrast for one worker: while a long campaign has no result yet, it could fail every waiting rollout once.
    places = ((Place("host", host), shared, contrast), (Place("worker", worker), own, True))
    return tuple(place for place, found, allowed in places if allowed and found.failures >= limits.in_a_row)


def set_aside(standings: Standings, place: Place, at: float, limits: Limits) -> Standings:
    """Begin the next pause of a place; its failures so far no longer count against their rollouts."""
    old = standings[place]
    # The number of failures stays: after the pause one more is enough.
    new = replace(old, attempts=frozenset(), pauses=old.pauses + 1, until=at + pause(old.pauses, limits))
    return {**standings, place: new}


def pause(before: int, limits: Limits) -> float:
    """Return the length of a pause after so many others, in s.

    >>> [pause(before, Limits()) for before in (0, 1, 5, 6, 10**6)]
    [30.0, 60.0, 960.0, 1800.0, 1800.0]
    """
    # Capped before the power, which overflows from 1024 on.
    return min(limits.first_pause * 2.0 ** min(before, 60), limits.longest_pause)


def resume_early(standings: Standings, worker: str, host: str, at: float) -> tuple[Standings, tuple[Place, ...]]:
    """End the pauses of a worker that is needed now; return their places, too."""
    back = tuple(place for place in _places(worker, host) if place in standings and at < standings[place].until)
    return {**standings, **{place: replace(standings[place], until=at) for place in back}}, back


def recent(standings: Standings, places: Container[Place], at: float, limits: Limits) -> Standings:
    """Return the standings that are not long past, and those of `places`, which have a worker."""
    keep = limits.longest_pause
    return {place: old for place, old in standings.items() if place in places or at < old.last + keep}


def _places(worker: str, host: str) -> tuple[Place, Place]:
    return Place("worker", worker), Place("host", host)
