"""Second opinions: a result that is compared counts once another worker has sent the same bytes.

Compared are the rollouts that the campaign chose, and the first three results of every worker while another one is
there. Of a first result its digest is kept alone; the rollout then waits for a worker that has not simulated it, of
another host first (`retries`), also while one is out of reach or may still come after a restart (`waits`). Where there
is none, its only worker is given up, so that a local one is replaced by a fresh process, and simulates it again. Two
equal digests agree: the rollout is recorded. Two that differ ask a third worker; where there is none, the third attempt
of the same ones, in a fresh process where it can be, is the last.
Whoever differs from two workers that agree is outvoted: set aside for good, also where it is one of these two, because
it has contradicted itself. Nothing that an outvoted worker has sent counts as an opinion any more. Without a majority
the rollout is poisoned: a worker that is alone has to agree with itself each time. What was compared before a restart
counts after it, so that no restart makes two that differ one that agrees.

Of a batch a rollout may fail in one result and not in another one. That is a failure of the system, and outvotes
nobody. A result counts once every rollout that it has is in another result as well; those that failed in it are made
again.

A *doubtful* result is unlike all others in its form. It is repeated in the same way, and counts once two digests agree,
be they of one worker: the system may fail in any process. A result that is not doubtful settles the doubt at once. What
differs from the one that counts is then a failure of the system, and nobody is outvoted.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from ....schemas.failure import Failure
from ....schemas.ids import Attempt, WorkId
from .blame import charge
from .choice import has_others, is_alone, is_outvoted
from .events import Action, Compared, Delivered, Fail, GiveUp, Opinion, Outvoted, Poison, SetAside
from .standing import FOR_GOOD, Place, Standing, Standings
from .state import DispatchState

FIRST = 3
"""Results of a worker that are compared always: a wrong build or a broken simulator shows in the first ones."""
MOST = 3
"""Results of a rollout of which two have to agree."""
UNLIKE = Failure("system", "its trajectory is not the one that its repetition gave")
"""The failure of a doubtful result that is not repeated."""
PARTLY = Failure("system", "rollouts failed in its batch that do not fail in a repetition")
"""The failure of a result that lacks rollouts of the one that counts."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The state after a result, whether it is to be recorded, and what else follows."""

    state: DispatchState
    counts: bool
    actions: tuple[Action, ...] = ()


def consider(state: DispatchState, event: Delivered) -> Decision:
    """Take a valid result of an open rollout."""
    name, rollout = event.worker, event.attempt.rollout
    known = state.open[rollout]
    # Dropped, and acknowledged all the same, or the worker would deliver it again and again.
    if is_outvoted(state, name):
        return Decision(queued_again(state, rollout), counts=False)
    # A rollout that is compared stays so: an opinion for honesty is not settled by the rules of a doubt.
    compared = known.compare or not all(each.doubtful for each in known.opinions) or _is_first(state, name, event.at)
    if not (compared or event.doubtful):
        return _settled(state, rollout, event)
    if any((each.attempt, each.worker) == (event.attempt, name) for each in known.opinions):
        return Decision(queued_again(state, rollout), counts=False)  # the acknowledgement was lost
    repeats = any(each.worker == name for each in known.opinions)
    if repeats and not is_alone(state, rollout, event.at):
        return Decision(queued_again(state, rollout), counts=False)  # an attempt of before, and another worker is there
    opinion = Opinion(name, state.host(name), event.attempt, event.digest, doubtful=not compared, each=event.each)
    known = replace(known, opinions=(*known.opinions, opinion))
    state = replace(state, open={**state.open, rollout: known})
    noted = Compared(name, event.attempt, event.digest, event.each)
    counted = [each for each in known.opinions if not is_outvoted(state, each.worker)]
    agreeing = [each.worker for each in counted if has_all_of(each, event)]
    # A doubt is one about the system, so two equal results of one worker settle it.
    if not compared and len(agreeing) > 1:
        return _settled(state, rollout, event, noted)
    # A worker that repeats itself says nothing against another one, nor against what it has sent before.
    if len(agreeing) > 1 and (len(set(agreeing)) > 1 or len(agreeing) == len(counted)):
        return _agreed(state, opinion, agreeing, noted, event.at)
    # Without a majority among three only a worker that is not here could tell who is right.
    if len(counted) >= MOST:
        return _divided(state, rollout, noted)
    # In a fresh process, or what the old one drew at its start would agree with itself.
    alone = compared and is_alone(state, rollout, event.at)
    fresh = (GiveUp(name),) if alone else ()
    return Decision(queued_again(state, rollout), counts=False, actions=(noted, *fresh))


def without(standings: Standings, workers: Iterable[str]) -> Standings:
    """Return the standings with workers that are set aside for good."""
    places = [Place("worker", name) for name in workers]
    # `last` as well: by it standings are forgotten, and workers get rollouts again where all are set aside.
    banned = {each: replace(standings.get(each, Standing()), last=FOR_GOOD, until=FOR_GOOD) for each in places}
    return {**standings, **banned}


def queued_again(state: DispatchState, rollout: WorkId) -> DispatchState:
    """Let an open rollout wait for a worker, before all others, unless it waits or is simulated already."""
    if not state.is_undecided(rollout):
        return state
    return replace(state, waiting=(rollout, *state.waiting))


def _is_first(state: DispatchState, worker: str, at: float) -> bool:
    if not state.second_opinion or state.comparisons.get(worker, 0) >= FIRST:
        return False
    # Not of a worker that is alone: every fresh process would have first results, without end.
    return has_others(state, worker, at)


def _settled(state: DispatchState, rollout: WorkId, event: Delivered, *noted: Action) -> Decision:
    """Let a result count, and those before it that differ be failures of the system."""
    actions: list[Action] = [*noted]
    for each in state.open[rollout].opinions:
        if not has_all_of(each, event):
            # As any failure: who often sends what is unlike all others is set aside, and nobody outvoted for a doubt.
            state, failed = _charged(state, each, UNLIKE if contradicts(each, event) else PARTLY, event.at)
            actions += failed
    return Decision(state, counts=True, actions=tuple(actions))


def _charged(state: DispatchState, opinion: Opinion, failure: Failure, at: float) -> tuple[DispatchState, list[Action]]:
    failed = Fail(opinion.worker, opinion.attempt, failure)
    state, aside = charge(state, failed, at)
    return state, [failed, *aside]


def has_all_of(opinion: Opinion, other: Opinion | Delivered) -> bool:
    """Whether an opinion has every rollout that another result has, bit by bit; of a batch it may have more."""
    pairs = _pairs(opinion, other)
    return opinion.digest == other.digest or (bool(pairs) and all(theirs in (b"", own) for own, theirs in pairs))


def contradicts(opinion: Opinion, other: Opinion | Delivered) -> bool:
    """Whether an opinion differs from another result in a rollout that both have."""
    pairs = _pairs(opinion, other)
    if opinion.digest == other.digest:
        return False
    return not pairs or any(own and theirs and own != theirs for own, theirs in pairs)


def _pairs(opinion: Opinion, other: Opinion | Delivered) -> list[tuple[bytes, bytes]]:
    """Return both digests of each rollout of a batch; none where it is a rollout alone."""
    return list(zip(opinion.each, other.each, strict=True)) if len(opinion.each) == len(other.each) else []


def _agreed(state: DispatchState, last: Opinion, agreeing: list[str], compared: Compared, at: float) -> Decision:
    """Let a result count that two agree on; whoever has sent another one is outvoted."""
    rollout = last.attempt.rollout
    if len(set(agreeing)) > 1:  # of a worker that was alone nothing has been compared with another one's
        counts = {name: state.comparisons.get(name, 0) + 1 for name in agreeing if name in state.workers}
        state = replace(state, comparisons={**state.comparisons, **counts})
    actions: list[Action] = [compared]
    for each in state.open[rollout].opinions:
        if has_all_of(each, last) or is_outvoted(state, each.worker):
            continue
        if not contradicts(each, last):
            state, failed = _charged(state, each, PARTLY, at)
            actions += failed
            continue
        place = Place("worker", each.worker)
        state = replace(state, standings=without(state.standings, [each.worker]))
        actions += [Outvoted(each.worker, each.attempt, each.digest)]
        actions += [SetAside(place, FOR_GOOD, _grounds(rollout, each.worker, agreeing))]
        actions += [GiveUp(each.worker)] if each.worker in state.workers else []
    return Decision(state, counts=True, actions=tuple(actions))


def _grounds(rollout: WorkId, worker: str, agreeing: list[str]) -> str:
    if worker not in agreeing:
        return f"its trajectory of {rollout} differs from that of two others ({', '.join(agreeing)})"
    others = ", ".join(each for each in agreeing if each != worker)
    return f"its trajectory of {rollout} differs from another one of its own, which is that of {others}"


def _divided(state: DispatchState, rollout: WorkId, compared: Compared) -> Decision:
    known = state.open[rollout]
    state = replace(state, open={**state.open, rollout: replace(known, poisoned=True)})
    differing = tuple(_difference(each.worker, each.attempt, each.digest) for each in known.opinions)
    return Decision(state, counts=False, actions=(compared, Poison(rollout, (*known.failures, *differing))))


def _difference(worker: str, attempt: Attempt, digest: str) -> Fail:
    return Fail(worker, attempt, Failure("system", f"a trajectory like no other one, with the sha256 {digest[:12]}..."))
