"""The one loop of the orchestrator: take messages, write facts, commit, then act.

A turn takes what has been received, in order, and at most one tick of the clock behind it. Everything that a turn
decides is committed in one transaction; only then do messages leave.
"""

import queue
import shlex
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ...schemas.campaign import CampaignConfig
from ...schemas.errors import PerfboundError, Stopped, one_line
from ...schemas.failure import Failure
from ...schemas.ids import CLOSING, Attempt, RolloutId
from ...schemas.messages import Ack, Assign, Cancel, Refuse, Request
from ...schemas.values import ProblemProgress
from ..campaign.ledger import Ledger, Work
from ..fleet import dispatch, events
from ..fleet.processes import Fleet
from ..fleet.transport import Garbage, Heartbeat, Inbound, Result, Token, Transport
from ..store import read
from ..store.journal import Journal
from .assignments import Assignments
from .results import Results
from .roster import Roster, WorkerRecord

TICK = 0.25
"""Seconds between two ticks of the dispatch machine."""
TURN = 64
"""Messages in one transaction at most; about 100 ms of work."""
ADOPTION = 2.5
"""Seconds after a restart in which busy workers report and outboxes drain, before anything is assigned."""


@dataclass(frozen=True, slots=True)
class Interrupted:
    """The event of a signal that stops the orchestrator."""

    signal: int


@dataclass(frozen=True, slots=True)
class RunStatus:
    """The state of a run at one moment, for listeners."""

    config: CampaignConfig
    problems: Mapping[str, ProblemProgress]
    """By name, in the order of the campaign file."""
    closing: Mapping[str, ProblemProgress]
    """The closing checks that have begun, by name."""
    workers: Mapping[str, str]
    """Name and phase of every worker."""
    known: Mapping[str, WorkerRecord]
    """The last messages of the workers, by name; it changes under the reader."""
    recorded: int
    """Rollouts since this orchestrator started."""
    waiting: int
    seconds: float


class Listener(Protocol):
    """A form of progress output."""

    def print_line(self, line: str) -> None:
        """Print one line."""
        ...

    def show(self, status: RunStatus) -> None:
        """Show the progress; called every tick."""
        ...


class Service:
    """Runs one campaign until it is done, it fails, or a signal stops it; other threads may use `inbox` alone."""

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
        self._roster = Roster(ledger.header.spec)
        self._results = Results(ledger, journal)
        self._assignments = Assignments(journal.directory, journal.header.run)
        self._outgoing: list[tuple[str, Request]] = []
        self._events: deque[events.Event] = deque()
        self._drain = drain
        self._draining: int | None = None
        self._stop: int | None = None
        self._poisoned: events.Poison | None = None
        self._told: set[tuple[RolloutId, Failure]] = set()
        self._unproved: set[str] = set()
        self._started = time.monotonic()
        self._next_tick = self._started
        limits = _limits(ledger.config)
        # Workers that connect may be busy since before a restart; those of our own fleet have just started.
        hold = self._started + ADOPTION if resumed and fleet is None else 0.0
        self._state = dispatch.DispatchState(limits, hold)

    def run(self) -> None:
        """Serve until every problem has stopped.

        Raises:
            Stopped: a signal arrived.
            PerfboundError: a rollout is poisoned, local workers do not live, or the mathematics cannot continue.
            OSError: the disk is full.

        """
        attempts = read.attempts(self._journal.directory)
        with self._ledger.transaction():
            self._demand(self._ledger.outstanding(), attempts)
            self._settle()
        self._send()
        while not self._ledger.done:
            self._turn(*self._receive())
        self._show()  # the last turn ends between two ticks

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
        # The inbox may contain more: time is complete only up to the last message taken, and a signal has no time.
        return messages, messages[-1].at if not isinstance(messages[-1], Interrupted) else 0.0

    def _turn(self, messages: list[Inbound | Interrupted], complete: float) -> None:
        with self._ledger.transaction():
            for message in messages:
                self._take(message)
                # Before the next message: its admission reads which rollouts are still open.
                self._settle()
            # No tick before an earlier message, which may be the heartbeat of a worker that would be given up.
            if complete >= self._next_tick:
                self._tick(complete)
            if self._draining is None:
                self._events.append(events.HandOut(time.monotonic()))
                self._settle()
            elif not dispatch.under_way(self._state):
                self._stop = self._draining
        # After the commit: kill -9 before it loses facts that no worker has received, so all of them are made again.
        self._send()

    def _take(self, message: Inbound | Interrupted) -> None:
        match message:
            case Token():
                self._events.extend(self._roster.token(message))
            case Heartbeat():
                if (reason := self._roster.refusal(message)) is not None:
                    self._print_line(f"refused worker {message.worker}: {reason}")
                    self._outgoing.append((message.worker, Refuse(reason=reason)))
                self._events.extend(self._roster.heartbeat(message))
            case Result():
                # One that comes before the worker is admitted is not acknowledged: the worker delivers it again.
                if self._roster.admitted(message.worker) is not None:
                    self._take_result(message)
            case Garbage():
                self._print_line(f"ignored a message of {message.worker}: {message.reason}")
            case Interrupted():
                self._interrupted(message.signal)

    def _take_result(self, message: Result) -> None:
        header = message.header
        if self._assignments.proved(message.worker, header):
            self._events.append(self._results.take(message, open_rollouts=self._state.open))
            return
        # Of another peer, or of an attempt whose key is lost: nothing is recorded, and no worker keeps it for ever.
        if message.worker not in self._unproved:
            self._unproved.add(message.worker)
            self._print_line(f"ignored results in the name of {message.worker}: no assignment proves them")
        self._outgoing.append((message.worker, Ack(rollout=header.rollout, attempt=header.attempt)))

    def _interrupted(self, signal: int) -> None:
        """Stop at once; with `drain`, hand out nothing more and stop when the attempts under way have ended."""
        if not self._drain or self._draining is not None:
            self._stop = signal
            return
        self._draining = signal
        under_way = dispatch.under_way(self._state)
        self._print_line(f"draining: {under_way} rollouts are under way; a second signal stops at once")

    def _tick(self, now: float) -> None:
        self._next_tick = now + TICK
        for news in self._fleet.tend() if self._fleet is not None else ():
            self._print_line(news)
        # `now` is the end of the last wait for messages, not the present: what came since is no silence of a worker.
        self._events.append(events.Tick(now))
        self._settle()
        self._show()

    def _settle(self) -> None:
        """Step the dispatch machine until no event is left; an action may add events, which wait for their turn."""
        while self._events:
            self._state, actions = dispatch.advance(self._state, self._events.popleft())
            for action in actions:
                self._act(action)
        self._results.clear()  # also those that the machine did not record: megabytes each

    def _act(self, action: events.Action) -> None:
        """Carry out an action of the dispatch machine; messages are kept until the commit."""
        match action:
            case events.Record(worker, attempt):
                self._demand(self._results.record(worker, attempt), {})
            case events.Start(worker, attempt):
                state = self._roster.admitted(worker)
                assert state is not None, "the dispatch machine has admitted workers only"
                self._journal.attempt_started(attempt, worker, state.host, state.pid)
                self._assign(worker, attempt)
            case events.Resend(worker, attempt):
                self._assign(worker, attempt)
            case events.Revoke(worker, attempt):
                self._outgoing.append((worker, Cancel(rollout=str(attempt.rollout), attempt=attempt.number)))
            case events.Acknowledge(worker, attempt):
                self._outgoing.append((worker, Ack(rollout=str(attempt.rollout), attempt=attempt.number)))
            case events.Fail(worker, attempt, failure):
                self._journal.attempt_ended(attempt, worker, failure)
                # Once: attempts that fail alike are counted in the database, and listed if they end the campaign.
                if (attempt.rollout, failure) not in self._told:
                    self._told.add((attempt.rollout, failure))
                    self._print_line(_failure_line(action))
            case events.GiveUp(worker):
                if self._fleet is not None and self._fleet.kill(worker):
                    # Before its token is gone, so that nothing is assigned to it.
                    self._events.append(events.WorkerDown(time.monotonic(), worker))
            case events.Poison():
                self._poisoned = action

    def _demand(self, work: Work, attempts: Mapping[RolloutId, int]) -> None:
        """Want rollouts, or no longer; `attempts` are those made before a restart."""
        now = time.monotonic()
        if work.unwanted:
            self._events.append(events.Unwanted(now, tuple(work.unwanted)))
        if work.wanted:
            wanted = tuple((each, attempts.get(each, 0)) for each in work.wanted)
            self._events.append(events.Wanted(now, wanted, self._results.recorders(work.wanted)))

    def _assign(self, worker: str, attempt: Attempt) -> None:
        request = self._ledger.request(attempt.rollout)
        secret = self._assignments.secret(worker, attempt)
        self._outgoing.append((worker, Assign(attempt=attempt.number, secret=secret, request=request)))

    def _send(self) -> None:
        """Send what the turn has decided, then end the run if the turn has decided that."""
        # Also before it ends: results of this turn are durable, and their workers may drop them.
        for worker, message in self._outgoing:
            self._transport.send(worker, message)
        self._outgoing.clear()
        if self._stop is not None:
            raise Stopped(self._stop)
        if self._poisoned is not None:
            raise PerfboundError(_poison_text(self._poisoned, self._ledger))

    def _print_line(self, line: str) -> None:
        for listener in self._listeners:
            listener.print_line(line)

    def _show(self) -> None:
        status = RunStatus(
            self._ledger.config,
            {name: account.progress for name, account in self._ledger.accounts.items()},
            {name: each.progress for name, each in self._ledger.series.items() if name in CLOSING},
            {name: worker.phase for name, worker in self._state.workers.items()},
            self._roster.records,
            self._state.recorded,
            len(self._state.waiting),
            time.monotonic() - self._started,
        )
        for listener in self._listeners:
            listener.show(status)


def _failure_line(action: events.Fail) -> str:
    attempt, failure = action.attempt, action.failure
    # The reason is text of a system under test.
    reason = one_line(failure.reason)
    return f"{attempt.rollout}, attempt {attempt.number} on {action.worker}, {failure.kind} failure: {reason}"


def _poison_text(found: events.Poison, ledger: Ledger) -> str:
    """Return the history of a rollout that fails again and again, the command that repeats it, and the remedy."""
    request, config = ledger.request(found.rollout), ledger.config
    by_reason: dict[str, list[str]] = {}
    for each in found.failures:
        attempt = f"attempt {each.attempt.number} on {each.worker}"
        by_reason.setdefault(each.failure.reason, []).append(attempt)
    history = "; ".join(f"{', '.join(attempts)}: {reason}" for reason, attempts in by_reason.items())
    options = [f"--option={name}={value}" for name, value in config.system.options.items()]
    start = ",".join(map(repr, request.x))
    rollout = [f"--x={start}", "--variant", request.variant, "--seed", str(request.seed)]
    system = config.system.python or config.system.name or "CAMPAIGN.toml"
    horizon = ["--horizon", f"{request.horizon:g}"]
    command = shlex.join(["perfbound", "simulate", system, *rollout, *horizon, *options, "--out", "failed.mcap"])
    repeat = f"Repeat it: {command}"
    if ledger.header.spec.repeated == "session":  # which no command has
        repeat = f"Repeat it: call {request.system.replace('-', '_')} at {start}, with seed {request.seed}"
    # Another code is another system, with which the recorded rollouts cannot be mixed.
    remedy = "If the code of the system is wrong, fix it and start a new campaign (--out); else"
    return (
        f"rollout {found.rollout} failed {len(found.failures)} times, so the campaign cannot continue: {history}. "
        f"{repeat}. {remedy} fix the worker or the machine, then resume"
    )


def _limits(file: CampaignConfig) -> dispatch.Limits:
    return dispatch.Limits(hung_after=file.hung_after, deadline=file.deadline, max_attempts=file.max_attempts)
