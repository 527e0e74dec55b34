"""The one loop of the orchestrator: take events, write facts, commit, then act.

A turn takes what has been received, in order, and at most one tick of the clock behind it, so that a busy
orchestrator never takes a worker for dead whose message it has not read yet. Everything that a turn decides is
committed in one transaction; only then do messages leave.
"""

import os
import queue
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ...schemas import __version__
from ...schemas.campaign import CampaignConfig
from ...schemas.errors import EvidenceError, PerfboundError, Stopped
from ...schemas.facts import RECORDED, RESTORED
from ...schemas.ids import Attempt, RolloutId
from ...schemas.messages import PROTOCOL, Ack, Assign, Cancel, Refuse, Request, WorkerState
from ...schemas.trajectory import Trajectory
from ...schemas.values import ProblemProgress
from ..campaign.admission import admit
from ..campaign.ledger import Ledger, Work
from ..fleet import dispatch, events
from ..fleet.processes import Fleet
from ..fleet.transport import Garbage, Heartbeat, Inbound, Result, Token, Transport
from ..store.journal import Journal

TICK = 0.25
"""Seconds between two looks at the clock."""
TURN = 64
"""Messages in one transaction at most; about 100 ms of work."""
ADOPTION = 2.5
"""Seconds after a restart in which busy workers report and outboxes drain, before anything is assigned."""


@dataclass(frozen=True, slots=True)
class Interrupted:
    """A signal asks the orchestrator to stop."""

    signal: int


@dataclass(slots=True)
class WorkerRecord:
    """A worker process as the protocol shows it."""

    alive: bool = False
    state: WorkerState | None = None
    refused: bool = False
    heard: float = 0.0
    """Of its last heartbeat, by the monotonic clock."""


@dataclass(frozen=True, slots=True)
class RunStatus:
    """The state of a run at one moment, for listeners."""

    config: CampaignConfig
    problems: Mapping[str, ProblemProgress]
    """By name, in the order of the campaign file."""
    workers: Mapping[str, str]
    """Name and phase of every worker."""
    known: Mapping[str, WorkerRecord]
    """The last messages of the workers, by name; it changes under the reader."""
    recorded: int
    """Rollouts since this orchestrator started."""
    waiting: int
    seconds: float


class Listener(Protocol):
    """Where progress is shown."""

    def say(self, line: str) -> None:
        """Print one event."""
        ...

    def show(self, status: RunStatus) -> None:
        """Show the progress; called every tick."""
        ...


class Service:
    """Runs one campaign until it is done, it fails, or a signal stops it."""

    def __init__(
        self,
        ledger: Ledger,
        journal: Journal,
        transport: Transport,
        fleet: Fleet | None,
        listeners: Sequence[Listener],
        *,
        resumed: bool,
        drain: bool = False,
    ) -> None:
        self.inbox: queue.SimpleQueue[Inbound | Interrupted] = queue.SimpleQueue()
        self._ledger = ledger
        self._journal = journal
        self._transport = transport
        self._fleet = fleet
        self._listeners = listeners
        self._known: dict[str, WorkerRecord] = {}
        self._outgoing: list[tuple[str, Request]] = []
        self._drain = drain
        self._draining: int | None = None
        self._stop: int | None = None
        self._poisoned: tuple[RolloutId, tuple[str, ...]] | None = None
        self._events: deque[events.Event] = deque()
        self._results: dict[Attempt, tuple[Result, Trajectory]] = {}
        """Admitted results that the dispatch machine has not decided on."""
        self._started = time.monotonic()
        self._next_tick = self._started
        self._spec_sha256 = ledger.header.spec.digest
        self._columns = tuple(column.name for column in ledger.header.spec.columns)
        config = ledger.config
        limits = dispatch.Limits(
            hung_after=config.hung_after, deadline=config.deadline, max_attempts=config.max_attempts
        )
        # Only workers of another orchestrator's time can be busy already; those of our own fleet start empty.
        hold = self._started + ADOPTION if resumed and fleet is None else 0.0
        self._state = dispatch.initial(limits, hold)

    def run(self) -> None:
        """Serve until every problem has stopped.

        Raises:
            Stopped: a signal arrived.
            PerfboundError: a rollout is poison, local workers do not live, or the mathematics cannot go on.
            OSError: the disk is full.

        """
        attempts = self._journal.attempts()
        with self._ledger.transaction():
            self._demand(self._ledger.outstanding(), attempts)
            self._settle()
        self._send()
        while not self._ledger.done:
            self._turn(*self._receive())
        self._show()

    def _receive(self) -> tuple[list[Inbound | Interrupted], float]:
        """Wait for the next message or tick; return messages, and the time up to which they are all that came."""
        messages: list[Inbound | Interrupted] = []
        while len(messages) < TURN:
            now = time.monotonic()
            wait = 0.0 if messages else max(0.0, self._next_tick - now)
            try:
                messages.append(self.inbox.get(timeout=wait) if wait > 0 else self.inbox.get_nowait())
            except queue.Empty:
                return messages, now + wait
        return messages, messages[-1].at if not isinstance(messages[-1], Interrupted) else 0.0

    def _turn(self, messages: list[Inbound | Interrupted], complete: float) -> None:
        with self._ledger.transaction():
            for message in messages:
                self._take(message)
                self._settle()
            if complete >= self._next_tick:
                self._tick(complete)
            if self._draining is None:
                self._events.append(events.HandOut(time.monotonic()))
                self._settle()
            elif not dispatch.under_way(self._state):
                self._stop = self._draining
        self._send()

    def _take(self, message: Inbound | Interrupted) -> None:
        match message:
            case Token():
                self._token(message)
            case Heartbeat():
                self._heartbeat(message)
            case Result():
                self._result(message)
            case Garbage():
                self._say(f"ignored a message of {message.worker}: {message.reason}")
            case Interrupted():
                self._interrupted(message.signal)

    def _interrupted(self, signal: int) -> None:
        """Stop at once; with `drain`, hand out nothing more and stop when the attempts under way have ended."""
        if not self._drain or self._draining is not None:
            self._stop = signal
            return
        self._draining = signal
        count = dispatch.under_way(self._state)
        self._say(f"draining: {count} rollouts are under way; a second signal stops at once")

    def _token(self, message: Token) -> None:
        known = self._known.setdefault(message.worker, WorkerRecord())
        known.alive = message.alive
        if known.state is not None and not known.refused:
            event = events.WorkerUp if message.alive else events.WorkerDown
            self._events.append(event(message.at, message.worker))
        if not message.alive and (known.state is None or known.refused):
            del self._known[message.worker]

    def _heartbeat(self, message: Heartbeat) -> None:
        known = self._known.get(message.worker)
        if known is None or not known.alive or known.refused:
            return  # its token comes first, also after a partition
        if known.state is None:
            if (reason := self._mismatch(message.state)) is not None:
                known.refused = True
                self._say(f"refused worker {message.worker}: {reason}")
                self._outgoing.append((message.worker, Refuse(reason=reason)))
                return
            known.state = message.state
            self._events.append(events.WorkerUp(message.at, message.worker))
        known.heard = message.at
        state = known.state = message.state
        busy = None
        if state.rollout is not None and state.attempt is not None:
            busy = Attempt(RolloutId.parse(state.rollout), state.attempt)
        self._events.append(events.Reported(message.at, message.worker, busy, state.progress))

    def _mismatch(self, state: WorkerState) -> str | None:
        spec = self._ledger.header.spec
        if state.protocol != PROTOCOL or state.version != __version__:
            theirs, ours = f"{state.version} (protocol {state.protocol})", f"{__version__} (protocol {PROTOCOL})"
            return f"the worker is perfbound {theirs}, the orchestrator {ours}; install the same version on both"
        if spec.name not in state.systems:
            return f"the worker has no system {spec.name!r}; install the package that provides it"
        if state.systems[spec.name] != self._spec_sha256:
            planned = ", ".join(f"{name} {version}" for name, version in spec.versions.items())
            return (
                f"the worker's {spec.name!r} differs from the one this campaign was planned for ({planned}); "
                "install the same versions"
            )
        return None

    def _result(self, message: Result) -> None:
        known = self._known.get(message.worker)
        if known is None or known.state is None or known.refused:
            return  # not acknowledged, so it comes again once the worker is known
        attempt = Attempt(RolloutId.parse(message.header.rollout), message.header.attempt)
        # A result that nobody wants any more is acknowledged unread.
        error = self._admit(attempt, message) if attempt.rollout in self._state.open else None
        self._events.append(events.Delivered(message.at, message.worker, attempt, error))

    def _admit(self, attempt: Attempt, message: Result) -> str | None:
        """Keep a result until the dispatch machine has decided on it; return the reason if it is refused."""
        header = message.header
        if header.outcome == "failed":
            return header.error or "the worker gave no reason"
        request, columns = self._ledger.request(attempt.rollout), self._columns
        try:
            trajectory = admit(request, columns, message.payload, header.sha256)
        except EvidenceError as fault:
            return str(fault)
        self._results[attempt] = message, trajectory
        return None

    def _tick(self, now: float) -> None:
        # `now` is not later than the last look into the inbox: what waits there since is no silence of a worker.
        self._next_tick = now + TICK
        if self._fleet is not None:
            for news in self._fleet.tend():
                self._say(news)
        self._events.append(events.Tick(now))
        self._settle()
        self._show()

    def _settle(self) -> None:
        """Step the dispatch machine until no event is left; actions may add events, which wait for their turn."""
        while self._events:
            self._state, actions = dispatch.step(self._state, self._events.popleft())
            for action in actions:
                self._act(action)
        self._results.clear()

    def _act(self, action: events.Action) -> None:
        match action:
            case events.Record(worker, attempt):
                self._record(worker, attempt)
            case events.Start(worker, attempt):
                self._start(worker, attempt)
            case events.Resend(worker, attempt):
                self._assign(worker, attempt)
            case events.Cancel(worker, attempt):
                self._outgoing.append((worker, Cancel(rollout=str(attempt.rollout), attempt=attempt.number)))
            case events.Acknowledge(worker, attempt):
                self._outgoing.append((worker, Ack(rollout=str(attempt.rollout), attempt=attempt.number)))
            case events.Fail(worker, attempt, reason):
                self._journal.attempt_ended(attempt, worker, reason)
                self._say(f"{attempt.rollout}, attempt {attempt.number} on {worker}: {reason}")
            case events.GiveUp(worker):
                self._give_up(worker)
            case events.Poison(rollout, story):
                self._poisoned = (rollout, story)

    def _record(self, worker: str, attempt: Attempt) -> None:
        (message, trajectory), rollout = self._results[attempt], attempt.rollout
        header = message.header
        outcome = RESTORED if self._ledger.restores(rollout) else RECORDED
        work = self._ledger.record(rollout, message.payload, trajectory, header.sha256)
        self._journal.attempt_ended(attempt, worker, outcome, header.cpu_seconds, header.wall_seconds)
        self._demand(work, {})

    def _demand(self, work: Work, attempts: Mapping[RolloutId, int]) -> None:
        """Have rollouts simulated, or no longer; `attempts` are those made before a restart."""
        now = time.monotonic()
        if work.unwanted:
            self._events.append(events.Unwanted(now, tuple(work.unwanted)))
        if work.wanted:
            self._events.append(events.Wanted(now, tuple((each, attempts.get(each, 0)) for each in work.wanted)))

    def _start(self, worker: str, attempt: Attempt) -> None:
        state = self._known[worker].state
        assert state is not None, "only known workers are in the dispatch core"
        self._journal.attempt_started(attempt, worker, state.host, state.pid)
        self._assign(worker, attempt)

    def _assign(self, worker: str, attempt: Attempt) -> None:
        request = self._ledger.request(attempt.rollout)
        self._outgoing.append((worker, Assign(attempt=attempt.number, request=request)))

    def _give_up(self, worker: str) -> None:
        known = self._known.get(worker)
        if self._fleet is None or known is None or known.state is None:
            return
        if known.state.host == os.uname().nodename:
            self._fleet.kill(known.state.pid)

    def _send(self) -> None:
        for worker, message in self._outgoing:
            self._transport.send(worker, message)
        self._outgoing.clear()
        if self._stop is not None:
            raise Stopped(self._stop)
        if self._poisoned is not None:
            rollout, story = self._poisoned
            raise PerfboundError(
                f"rollout {rollout} failed {len(story)} times, so the campaign cannot go on: "
                + "; ".join(story)
                + ". Reproduce it with `perfbound simulate`, mend the cause, then resume"
            )

    def _say(self, line: str) -> None:
        for listener in self._listeners:
            listener.say(line)

    def _show(self) -> None:
        status = RunStatus(
            self._ledger.config,
            {name: account.progress for name, account in self._ledger.accounts.items()},
            {name: worker.phase for name, worker in self._state.workers.items()},
            self._known,
            self._state.recorded,
            len(self._state.waiting),
            time.monotonic() - self._started,
        )
        for listener in self._listeners:
            listener.show(status)
