"""The dispatch machine: the attempt of each worker, lost and hung workers, retries, poisoned rollouts.

A pure machine: `advance(state, event) -> (state, actions)`. Time comes inside the events, in seconds of any one clock.
A worker is in one of these phases, and this table lists every legal transition of the worker that an event names:

    phase      WorkerUp   WorkerDown  Reported                  Delivered   HandedBack     Tick
    unknown    new        (ignored)   (ignored)                 unknown     unknown        -
    new        new        gone        new, idle, busy, shunned  new         new            new
    idle       idle       gone        idle, shunned             idle        idle           idle
    sent       sent       gone        sent, busy                sent, idle  sent, shunned  sent, shunned
    busy       busy       gone        busy                      busy, idle  busy, shunned  busy, shunned
    shunned    shunned    gone        shunned, idle             shunned     shunned        shunned
    gone       (back)     gone        (ignored)                 gone        gone           gone, unknown

`-` cannot be. `(ignored)` changes nothing. `(back)` is the phase before it was gone. Beyond the table, `HandOut` makes
an `idle` worker `sent` if a rollout waits, and a worker whose rollout is withdrawn, or recorded from another attempt,
becomes `shunned`. `HandOut` is an event of its own because the clock of an attempt must start when it is sent:
recording a result may take longer than the limit for a worker without progress.

`new` has not reported yet: it may be busy since before it was lost or the orchestrator was restarted. `sent` has an
assignment that no heartbeat has confirmed yet: it is sent again every `resend_after` s. `shunned` hung, missed its
deadline, was cancelled, or leaves (`leaving`). `new` and `shunned` workers get nothing until they report idle, and are
given up every `hung_after` s that they do not. `gone` has lost its liveliness token: after `lost_after` s its attempt
is lost, later where a router has come or gone (`routes`; `RouterChanged` and `LinkChanged` change no phase). Reports
that are late, repeated or of unknown rollouts change nothing but are acknowledged. `LEGAL` is all of this as data.

The first valid result of a rollout wins, whichever attempt it came from, unless it is compared with another one
(`opinions`). `retries` decides which workers come next after a failure, and when a rollout is poisoned: the campaign
fails and reports every attempt. `waits` decides how long a rollout waits for a worker that has not tried it. `standing`
decides which workers and hosts are set aside: their phases change as those of all others, but `HandOut` gives them
nothing. Closed rollouts leave the state. A failure of the system is recorded even if the rollout is closed; those that
the machine itself finds (lost, hung, late) are failures of the infrastructure.
"""

from dataclasses import replace
from typing import Literal

from ....schemas.failure import Failure
from ....schemas.ids import Attempt, WorkId, first_of, rollouts_of
from .blame import charge, clear, forget_past, take_back
from .choice import eligible, has_others, is_alone, nearest
from .events import (
    Acknowledge,
    Action,
    Delivered,
    Dismiss,
    Event,
    Fail,
    GiveUp,
    HandedBack,
    HandOut,
    LinkChanged,
    OftenHandedBack,
    Poison,
    Record,
    Reported,
    Requeue,
    Resend,
    Revoke,
    RouterChanged,
    Start,
    Tick,
    Unwanted,
    Wanted,
    WorkerDown,
    WorkerUp,
)
from .opinions import consider, queued_again
from .retries import ELSEWHERE, Open, blames_rollout, is_poison, missed
from .standing import Place
from .state import NEVER, DispatchState, Worker, WorkerPhase
from .waits import away, end_waits, given, hand_out, is_lost, link_changed, lost_after, router_changed

Phase = WorkerPhase | Literal["unknown"]
KNOWN: tuple[WorkerPhase, ...] = ("new", "idle", "sent", "busy", "shunned")

LEGAL: dict[tuple[Phase, str], tuple[Phase, ...]] = {
    ("unknown", "WorkerUp"): ("new",),
    **{("unknown", event): ("unknown",) for event in ("WorkerDown", "Reported", "Delivered", "HandedBack")},
    **{(phase, "WorkerUp"): (phase,) for phase in KNOWN},
    **{(phase, "WorkerDown"): ("gone",) for phase in KNOWN},
    # It stays `new` with an attempt that is revoked and not adopted, and is `shunned` if it leaves at once.
    ("new", "Reported"): ("new", "idle", "busy", "shunned"),
    ("idle", "Reported"): ("idle", "shunned"),
    **{(phase, event): (phase,) for phase in ("new", "idle") for event in ("Delivered", "HandedBack", "Tick")},
    ("idle", "HandOut"): ("idle", "sent"),
    # An idle heartbeat may have crossed the assignment, so it proves nothing: the worker stays `sent`.
    ("sent", "Reported"): ("sent", "busy"),
    ("sent", "Delivered"): ("sent", "idle"),
    **{("sent", event): ("sent", "shunned") for event in ("HandedBack", "Tick")},
    ("busy", "Reported"): ("busy",),
    ("busy", "Delivered"): ("busy", "idle"),
    # Whoever hands back is about to end, and gets nothing more.
    **{("busy", event): ("busy", "shunned") for event in ("HandedBack", "Tick")},
    ("shunned", "Reported"): ("shunned", "idle"),
    **{("shunned", event): ("shunned",) for event in ("Delivered", "HandedBack", "Tick")},
    # Only the network may have been away: a worker returns in the phase in which it went.
    ("gone", "WorkerUp"): KNOWN,
    **{("gone", event): ("gone",) for event in ("WorkerDown", "Reported", "Delivered", "HandedBack")},
    ("gone", "Tick"): ("gone", "unknown"),
}
"""(phase of the worker that an event names, or of any worker for HandOut and Tick; event) -> the phases after it."""
SIDE_EFFECTS: dict[tuple[Phase, str], tuple[Phase, ...]] = {
    (phase, event): ("shunned",) for phase in ("sent", "busy") for event in ("Unwanted", "Delivered")
}
"""Of any worker whose rollout is withdrawn, or recorded from another worker."""


Outcome = tuple[DispatchState, tuple[Action, ...]]


def advance(state: DispatchState, event: Event) -> Outcome:
    """Apply one event."""
    match event:
        case Wanted():
            return _want(state, event)
        case Unwanted():
            return _forget(state, event)
        case WorkerUp() | WorkerDown() | RouterChanged() | LinkChanged():
            return _present(state, event), ()
        case Reported():
            return _report(state, event)
        case Delivered():
            return _deliver(state, event)
        case HandedBack():
            return hand_back(state, event)
        case Tick():
            return _tick(state, event.at)
        case HandOut():
            return _assign(state, event.at)


def under_way(state: DispatchState) -> int:
    """Return the number of rollouts that workers have been given, each in an attempt that has not ended."""
    return sum(rollouts_of(worker.attempt.rollout) for worker in state.workers.values() if worker.attempt is not None)


def _want(state: DispatchState, event: Wanted) -> Outcome:
    # Numbered on from the attempts before a restart: a late result of theirs must not pass for one of a new attempt.
    fresh = ((rollout, attempts) for rollout, attempts in event.rollouts if rollout not in state.open)
    new = {rollout: _opened(event, rollout, attempts) for rollout, attempts in fresh}
    # Behind all others: a retry, for which the observation of its test waits, goes in front.
    state = replace(state, open={**state.open, **new}, waiting=(*state.waiting, *new))
    # A process that repeats its own rollouts repeats what it drew at its start as well: another one shows it.
    alone = eligible(state, event.at)
    repeats = len(alone) == 1 and any(known.avoid == alone[0] for known in new.values())
    repeats = repeats and not has_others(state, alone[0], event.at)
    return state, tuple(map(GiveUp, alone)) if repeats else ()


def _opened(event: Wanted, rollout: WorkId, attempts: int) -> Open:
    # Of before a restart only failures that blame the rollout: the machines may have been repaired since.
    earlier = event.failed.get(rollout, ())
    fails, hosts = tuple(each.fail for each in earlier), tuple(each.host for each in earlier)
    known = Open(attempts, fails, hosts, avoid=event.avoid.get(rollout), compare=rollout in event.compared)
    return replace(known, opinions=event.opinions.get(rollout, ()), handed_back=event.handed_back.get(rollout, 0))


def _forget(state: DispatchState, event: Unwanted) -> Outcome:
    withdrawn = frozenset(event.rollouts)
    dropped = frozenset(each for each in state.open if first_of(each) in withdrawn)
    cancels = []
    # The problem has stopped. A cancel may be lost, so the worker counts as busy until it reports idle.
    for name, worker in state.workers.items():
        if worker.attempt is not None and worker.attempt.rollout in dropped:
            cancels.append(Revoke(name, worker.attempt))
            state = _put(state, name, worker.shunned(event.at))
    return _close_rollouts(state, dropped), tuple(cancels)


def _present(state: DispatchState, event: WorkerUp | WorkerDown | RouterChanged | LinkChanged) -> DispatchState:
    match event:
        case WorkerUp():
            return _up(state, event)
        case WorkerDown():
            return _down(state, event)
        case RouterChanged():
            return router_changed(state, event)
        case LinkChanged():
            return link_changed(state, event)


def _up(state: DispatchState, event: WorkerUp) -> DispatchState:
    worker = state.workers.get(event.worker)
    if event.variants is not None:
        state = replace(state, variants={**state.variants, event.worker: event.variants})
    if worker is None:
        # Nothing is assigned before its first heartbeat: after a partition or a restart it may be busy.
        return _put(state, event.worker, Worker("new", host=event.host, started_at=event.at, progress_at=event.at))
    if worker.phase != "gone":
        return state  # a repeated token
    # A partition, not a death: the rollout has continued, and the time without messages counts against no limit.
    started = worker.started_at + away(state, worker, event.at)
    back = replace(
        worker,
        phase=worker.resumes_as,
        replaced=False,
        gone_at=NEVER,
        progress_at=event.at,
        sent_at=event.at,
        started_at=started,
    )
    return _put(state, event.worker, back)


def _down(state: DispatchState, event: WorkerDown) -> DispatchState:
    worker = state.workers.get(event.worker)
    if worker is None or worker.phase == "gone":
        return state
    # The attempt is kept for `lost_after` s: a token also disappears when the network does for a moment.
    gone = replace(worker, phase="gone", resumes_as=worker.phase, replaced=event.replaced, gone_at=event.at)
    return _put(state, event.worker, gone)


def _report(state: DispatchState, event: Reported) -> Outcome:
    worker = state.workers.get(event.worker)
    if worker is None or worker.phase == "gone":
        return state, ()  # a heartbeat that overtook its token, or was late
    if event.attempt is None:
        idle = _report_idle(state, event.worker, worker)
        return report_leaving(state, event, worker) if event.leaving else (idle, ())
    if event.attempt == worker.attempt:
        return _put(state, event.worker, _advanced(worker, event)), ()
    # Busy since before a restart, with a rollout that is still needed: its result is as good as a new one's.
    if worker.phase == "new" and _is_adoptable(state, event.attempt):
        return _adopt(state, event), ()
    # Busy with a rollout that is closed or on another worker, or that was cancelled by a message that got lost.
    if event.attempt.rollout not in state.open or worker.phase in ("new", "shunned"):
        return state, (Revoke(event.worker, event.attempt),)
    return state, ()  # the heartbeat before the assignment: an older attempt that has just ended


def _report_idle(state: DispatchState, name: str, worker: Worker) -> DispatchState:
    # A `sent` worker may report idle because its assignment is still on the way, a `busy` one because its result is:
    # the first is sent again, for the second the limit of progress runs.
    return _put(state, name, Worker("idle", host=worker.host)) if worker.phase in ("new", "shunned") else state


def _advanced(worker: Worker, event: Reported) -> Worker:
    # A heartbeat proves that the process lives; only growing progress proves that the rollout does.
    if event.progress <= worker.progress:
        return replace(worker, phase="busy")
    return replace(worker, phase="busy", progress=event.progress, progress_at=event.at)


def _adopt(state: DispatchState, event: Reported) -> DispatchState:
    assert event.attempt is not None
    rollout = event.attempt.rollout
    host = state.workers[event.worker].host
    worker = Worker("busy", event.attempt, host, started_at=event.at, progress=event.progress, progress_at=event.at)
    state = _put(state, event.worker, worker)
    # Else a second worker would get what this one is about to end.
    return replace(state, waiting=tuple(other for other in state.waiting if other != rollout))


def _is_adoptable(state: DispatchState, attempt: Attempt) -> bool:
    # One that was never made is a false report, and its number would be passed on to the attempts that follow.
    return attempt.rollout in state.waiting and attempt.number <= state.open[attempt.rollout].attempts


def _deliver(state: DispatchState, event: Delivered) -> Outcome:
    acknowledge, rollout = Acknowledge(event.worker, event.attempt), event.attempt.rollout
    is_held = _holds(state, event.worker, event.attempt)
    # First: what follows asks whether a worker still holds the rollout.
    state = _release(state, event.worker, event.attempt)
    failed, is_open = event.failure, rollout in state.open
    # Late, but evidence all the same: if another attempt was recorded, the system does not repeat with its seed.
    if failed is not None and (is_open or failed.kind == "system"):
        state, actions = _fail(state, event.worker, event.attempt, failed, event.at)
        return state, (*actions, acknowledge)
    if not is_open:  # a repeat, late or of no use: without the acknowledgement the worker sends it again
        return state, (acknowledge,)
    opinion = consider(state, event)
    state = opinion.state
    if not opinion.counts:
        return state, (*opinion.actions, acknowledge)
    # The first valid result counts, whichever attempt it is of: equal requests give equal bytes.
    if is_held:  # a rollout is on one worker or waits: a search through both would be a quarter of a large fleet's loop
        state, cancels = _close(state, frozenset({rollout})), tuple[Action, ...]()
    else:
        state, cancels = _cancel_others(state, rollout, event.at)
        state = _close_rollouts(state, frozenset({rollout}))
    state, back = clear(state, event.worker, event.at)
    # Record before Acknowledge: once acknowledged, no worker has the bytes any more.
    return state, (*opinion.actions, Record(event.worker, event.attempt), acknowledge, *cancels, *back)


def _holds(state: DispatchState, name: str, attempt: Attempt) -> bool:
    return name in state.workers and state.workers[name].attempt == attempt


def _release(state: DispatchState, name: str, attempt: Attempt) -> DispatchState:
    if not _holds(state, name, attempt):
        return state  # a result of an attempt before the present one
    worker = state.workers[name]
    if worker.phase == "gone":  # the result was on the way when the token disappeared
        return _put(state, name, replace(worker, attempt=None, resumes_as="idle"))
    return _put(state, name, Worker("idle", host=worker.host))


def _cancel_others(state: DispatchState, rollout: WorkId, at: float) -> Outcome:
    cancels = []
    for name, worker in state.workers.items():
        if worker.attempt is not None and worker.attempt.rollout == rollout:
            cancels.append(Revoke(name, worker.attempt))
            state = _put(state, name, worker.shunned(at))
    return state, tuple(cancels)


def _tick(state: DispatchState, at: float) -> Outcome:
    actions: list[Action] = []
    for name, worker in state.workers.items():
        state, more = _watch(state, name, worker, at)
        actions += more
    # After the watch: a wait ends when nobody is expected any more, and a lost worker no longer is.
    return forget_past(end_waits(state, at), at), tuple(actions)


def _watch(state: DispatchState, name: str, worker: Worker, at: float) -> Outcome:
    limits = state.limits
    if worker.phase == "gone":
        if not is_lost(state, worker, at):
            return state, ()
        seconds = f"{lost_after(state, at):g} s"
        lost, failed = Failure("infrastructure", f"worker lost for {seconds}"), tuple[Action, ...]()
        if worker.attempt is not None:
            # Without its attempt before the failure is counted: a rollout that a worker holds counts as decided.
            state = _put(state, name, replace(worker, attempt=None, resumes_as="shunned"))
            state, failed = _fail(state, name, worker.attempt, lost, at)
        # The whole entry is removed: if the process is alive, its token makes it a `new` worker, and it reports first.
        left = {key: value for key, value in state.workers.items() if key != name}
        # A process that returns under this name is compared anew, and memory does not grow with all that ever were.
        compared = {key: value for key, value in state.comparisons.items() if key != name}
        variants = {key: value for key, value in state.variants.items() if key != name}
        return replace(state, workers=left, comparisons=compared, variants=variants), failed
    # It neither reports idle nor disappears. `progress_at` starts anew, so that it is given up again later.
    if worker.phase in ("new", "shunned") and at - worker.progress_at >= limits.hung_after:
        return _put(state, name, replace(worker, progress_at=at)), (GiveUp(name),)
    if worker.attempt is None:
        return state, ()
    if at - worker.progress_at >= limits.hung_after:
        return _shun(state, name, worker, Failure("infrastructure", f"no progress for {limits.hung_after:g} s"), at)
    # Progress alone is not enough: a rollout may grow slower without end. A batch may take as long as its rollouts
    # one by one, which a system that is not vectorised simulates in turn.
    rollouts = rollouts_of(worker.attempt.rollout)
    if at - worker.started_at >= limits.deadline * rollouts:
        return _shun(state, name, worker, missed(limits.deadline, rollouts), at)
    # Delivery is at most once, so the assignment or the heartbeat that confirms it may be lost.
    if worker.phase == "sent" and at - worker.sent_at >= limits.resend_after:
        return _put(state, name, replace(worker, sent_at=at)), (Resend(name, worker.attempt),)
    return state, ()


def _shun(state: DispatchState, name: str, worker: Worker, failure: Failure, at: float) -> Outcome:
    assert worker.attempt is not None
    state = _put(state, name, worker.shunned(at))
    state, actions = _fail(state, name, worker.attempt, failure, at)
    # The failure may have given it up as well, and a process is ended once.
    others = tuple(action for action in actions if action != GiveUp(name))
    return state, (Revoke(name, worker.attempt), *others, GiveUp(name))


def _fail(state: DispatchState, name: str, attempt: Attempt, failure: Failure, at: float) -> Outcome:
    """Count the failure against the rollout, or against its worker, and queue the rollout again or poison it."""
    failed, rollout = Fail(name, attempt, failure), attempt.rollout
    known = state.open.get(rollout)
    if known is None or not state.is_undecided(rollout):
        return state, (failed,)  # a repeat, or another attempt is under way: no second count
    known = replace(known, failures=(*known.failures, failed), hosts=(*known.hosts, state.host(name)))
    state = replace(state, open={**state.open, rollout: known})
    # Blame first: a failure that sets its worker or host aside does not count against the rollout below.
    state, aside = charge(state, failed, at)
    limits, alone, elsewhere = state.limits, is_alone(state, rollout, at), nearest(state, rollout, at) == ELSEWHERE
    if is_poison(state.open[rollout], limits, proven=state.proven, alone=alone, elsewhere=elsewhere):
        state = replace(state, open={**state.open, rollout: replace(state.open[rollout], poisoned=True)})
        return state, (failed, *aside, Poison(rollout, known.failures))
    # In front: the observation of its test, and all that follow in the problem, wait for it.
    state = replace(state, waiting=(rollout, *state.waiting))
    # Something in this process may be the cause, and no other one can tell.
    suspect = Place("worker", name) in {each.place for each in aside} or (
        alone and blames_rollout(failure, limits.deadline)
    )
    return state, (failed, *aside, *((GiveUp(name),) if suspect else ()))


def _assign(state: DispatchState, at: float) -> Outcome:
    if at < state.hold_until or not state.waiting:
        return state, ()
    state, found, waits = hand_out(state, at)
    starts = tuple(Start(name, Attempt(rollout, state.open[rollout].attempts + 1)) for name, rollout in found)
    state, back = take_back(state, [name for name, _ in found], at)
    # Every clock of the attempt starts now, when it is sent, and not when its rollout began to wait.
    sent = {
        start.worker: replace(
            state.workers[start.worker], phase="sent", attempt=start.attempt, sent_at=at, started_at=at, progress_at=at
        )
        for start in starts
    }
    tried = {start.attempt.rollout: given(state.open[start.attempt.rollout], start.attempt) for start in starts}
    workers, opened = {**state.workers, **sent}, {**state.open, **tried}
    return replace(state, workers=workers, open=opened), (*waits, *back, *starts)


def _close_rollouts(state: DispatchState, rollouts: frozenset[WorkId]) -> DispatchState:
    waiting = tuple(each for each in state.waiting if each not in rollouts)
    return replace(_close(state, rollouts), waiting=waiting)


def _close(state: DispatchState, rollouts: frozenset[WorkId]) -> DispatchState:
    left = dict(state.open)  # a copy costs a tenth of a comprehension
    for rollout in rollouts:
        left.pop(rollout, None)
    return replace(state, open=left)


def _put(state: DispatchState, name: str, worker: Worker) -> DispatchState:
    return replace(state, workers={**state.workers, name: worker})


# A worker that ends: it gets nothing more, and what it hands back waits for another one at once. That counts against
# nobody: the reason lies in no rollout, worker or host, but in a scheduler or a person that ends the process. So a
# rollout is handed back as often as workers end; from `OFTEN` times on that is reported, once; those before a restart
# of the orchestrator count. The worker is `shunned` without its attempt; it never reports idle again, and is dismissed
# as soon as nothing can be on the way to it.

OFTEN = 10
"""Times that one rollout is handed back until that is reported: if every second attempt met the end of its worker by
chance, one rollout in a thousand would be; most of the time its workers live too short for it."""


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
    # Acknowledged all the same: the worker repeats it until it has that.
    if rollout not in state.open:
        return state, (acknowledge,)
    # In front, as after a failure; unless it waits or is simulated already, as when this is a repeat.
    state, often = _with_hand_back(state, event) if state.is_undecided(rollout) else (state, ())
    return queued_again(state, rollout), (Requeue(event.worker, event.attempt), acknowledge, *often)


def _with_hand_back(state: DispatchState, event: HandedBack) -> tuple[DispatchState, tuple[OftenHandedBack, ...]]:
    rollout = event.attempt.rollout
    known = replace(state.open[rollout], handed_back=state.open[rollout].handed_back + 1)
    state, times = replace(state, open={**state.open, rollout: known}), known.handed_back
    often = (OftenHandedBack(rollout, times, event.worker, state.host(event.worker)),) if times == OFTEN else ()
    return state, often


def _without_attempt(state: DispatchState, event: Reported | HandedBack, worker: Worker) -> DispatchState:
    leaving = replace(worker.shunned(event.at), leaving=True)
    return replace(state, workers={**state.workers, event.worker: leaving})
