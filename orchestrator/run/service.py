"""The one loop of the orchestrator: take messages, write facts, commit, then act.

A turn takes what has been received, in order, and at most one tick of the clock behind it. Everything that a turn
decides is committed in one transaction; only then do messages leave.
"""

import queue
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from ...schemas.batch import alone
from ...schemas.errors import Stopped
from ...schemas.file.config import CampaignConfig
from ...schemas.ids import WorkId, closing_check, first_of, rollouts_of
from ...schemas.values import ProblemProgress
from ..campaign.ledger import Ledger, Work
from ..fleet.children.processes import Fleet
from ..fleet.dispatch import events, machine
from ..fleet.dispatch.choice import out_of_favour
from ..fleet.dispatch.limits import Limits
from ..fleet.dispatch.state import DispatchState, Worker
from ..fleet.link.inbox import Inbox
from ..fleet.link.transport import Garbage, Heartbeat, Inbound, Linked, Result, RouterToken, Token, Transport
from ..forecast.planned_outlook import PlannedOutlooks
from ..store.commit_times import CommitTimes
from ..store.journal import Journal
from ..store.stop_request import take_request
from .collision import PoisonedError
from .decoder import Decoded
from .doubted_rollouts import Review
from .lines import Lines, poison_text
from .outbox import Assignments, Outbox
from .results import Results
from .roster import LIVING, Roster, WorkerRecord
from .routers import RouterLink, Routers
from .trust import NOTHING_BEFORE, earlier, note, still_aside

TICK = 0.25
"""Seconds between two ticks of the dispatch machine."""
TURN = 64
"""Messages in one transaction at most; about 100 ms of work."""
GATHERING = 0.005
"""Seconds at most, and a quarter of the last turn, that a busy loop waits for more results, which share a transaction
and its waits for the disk. Two workers with short rollouts would otherwise take turns, with one result in each; a
second assignment for each worker would be lost with it."""
UNNOTICED = 1.0
"""Seconds in which a worker without its token is shown as before: that a link is down is found after its tokens."""
ADOPTION = 2.5
"""Seconds after a restart in which busy workers report and outboxes drain, before anything is assigned."""


@dataclass(frozen=True, slots=True)
class Interrupted:
    """The event of a signal, or a request, that stops the orchestrator."""

    signal: int
    drain: bool | None = None
    """Whether the rollouts under way end first; None: as the run was started."""


Message = Inbound | Decoded | Interrupted
"""What wakes the loop."""


@dataclass(frozen=True, slots=True)
class LoopFigures:
    """What the loop itself has to do."""

    messages: int = 0
    """Those received that wait for the loop."""
    commits: CommitTimes = CommitTimes()  # noqa: RUF009  (frozen)
    done: bool = False
    """Whether the loop ends here: the certificate is all that is left."""


@dataclass(frozen=True, slots=True)
class RunStatus:
    """The state of a run at one moment, for listeners."""

    config: CampaignConfig
    problems: Mapping[str, ProblemProgress]
    """By name, in the order of the campaign file."""
    closing: Mapping[str, ProblemProgress]
    """The closing checks that have begun, by name."""
    workers: Mapping[str, str]
    """Name of every worker, and its phase, "set aside", or "out of reach" while the link to the router is down."""
    known: Mapping[str, WorkerRecord]
    """The last messages of the workers, by name; it changes under the reader."""
    recorded: int
    """Rollouts since this orchestrator started."""
    waiting: int
    seconds: float
    under_way: int = 0
    """Rollouts that workers have been given, each in an attempt that has not ended."""
    loop: LoopFigures = LoopFigures()
    link: RouterLink | None = None
    """To the router; None without one."""


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
        self.inbox: Inbox[Message] = Inbox()
        self._ledger, self._journal = ledger, journal
        self._fleet, self._listeners = fleet, listeners
        self._lines, self._roster = Lines(self._print_line), Roster(ledger.header.spec, journal.platform)
        self._routers, self._outlooks = Routers(self._print_line), PlannedOutlooks()
        self._review = Review(ledger, journal, self._print_line)
        self._results = Results(ledger, journal, self._review, self.inbox.put)
        self._assignments = Assignments(journal.directory, journal.header.run)
        self._outbox = Outbox(transport, self._assignments)
        self._events: deque[events.Event] = deque()
        self._drain = drain
        self._draining: int | None = None
        self._stop: int | None = None
        self._poisoned: events.Poison | None = None
        self._started = self._next_tick = time.monotonic()
        limits, banned = _dispatch_limits(ledger.config), still_aside(journal.attempts, self._print_line)
        self._state = DispatchState(limits, standings=banned, second_opinion=ledger.config.second_opinion > 0)
        if resumed:
            elsewhere = fleet is None or bool(journal.origin.options)
            self._state = _resumed(self._state, self._started, local=fleet is not None, elsewhere=elsewhere)

    def run(self) -> None:
        """Serve until every problem has stopped.

        Raises:
            Stopped: a signal arrived.
            PoisonedError: a rollout fails again and again.
            PerfboundError: local workers do not live, or the mathematics cannot continue.
            OSError: the disk is full.

        """
        with self._ledger.transaction():
            self._demand(self._ledger.outstanding(), resumed=True)
            self._settle()
            self._begin_review()
        self._send()
        took = 0.0
        while not self._done:
            messages, complete = _received(self.inbox, self._next_tick, took, machine.under_way(self._state))
            began = time.monotonic()
            self._turn(messages, complete)
            took = time.monotonic() - began
        self._show()  # the last turn ends between two ticks

    def report_end(self) -> None:
        """Report to every worker that the certificate is issued; a message that gets lost is not repeated."""
        # Also to those that have come since the last turn: one with --until-done would wait for another campaign.
        waiting = (self.inbox.get(0.0) for _ in range(self.inbox.waiting))
        late = [each.worker for each in waiting if isinstance(each, Heartbeat)]
        self._outbox.report_end(dict.fromkeys((*self._roster.living, *late)))

    @property
    def _done(self) -> bool:
        return self._ledger.done and not self._review

    def _begin_review(self) -> None:
        """Want once more what is doubted, when all else is done."""
        if self._done and (doubted := self._review.begin()):
            self._want(doubted, resumed=True)
            self._settle()

    def _turn(self, messages: list[Message], complete: float) -> None:
        with self._ledger.transaction():
            for message in messages:
                self._take(message)
                # Before the next message: its admission reads which rollouts are still open.
                self._settle()
            # No tick before an earlier message, which may be the heartbeat of a worker that would be given up.
            if complete >= self._next_tick:
                self._tick(complete)
            self._begin_review()
            if self._draining is None:
                # After the writes of the turn: the clocks of attempts start here, and a record may take long.
                self._events.append(events.HandOut(time.monotonic()))
                self._settle()
            elif not machine.under_way(self._state):
                self._stop = self._draining
        # After the commit: kill -9 before it loses facts that no worker has received, so all of them are made again.
        self._send()

    def _take(self, message: Message) -> None:
        match message:
            case Token():
                if self._roster.is_one_too_many(message):
                    self._lines.too_many(message.worker, LIVING)
                local = self._fleet is not None and self._fleet.replaces(message.worker)
                self._events.extend(self._roster.token(message, local=local))
            case Heartbeat():
                if (reason := self._roster.refusal(message)) is not None:
                    self._lines.refused(message.worker, reason)
                    self._outbox.refuse(message.worker, reason)
                found = self._roster.heartbeat(message)
                for variants in (each.variants for each in found if isinstance(each, events.WorkerUp)):
                    if variants is not None:
                        self._lines.simulates(message.worker, variants)
                self._events.extend(found)
            case Result() if self._roster.admitted(message.worker) is None:
                return  # not acknowledged before the worker is admitted: it delivers the result again
            case Result() if not self._assignments.proved(message.worker, message.header):
                # Of another peer, or of an attempt whose key is lost: nothing is recorded, and no worker keeps it.
                self._lines.ignored(message.worker, "no assignment proves its result")
                self._outbox.acknowledge(message.worker, message.attempt)
            case Result() | Decoded():
                self._events.extend(self._results.take(message, open_rollouts=self._state.open))
            case Garbage():
                self._lines.ignored(message.worker, message.reason)
            case RouterToken() | Linked():
                self._events.append(self._routers.take(message))
            case Interrupted():
                self._interrupted(message)

    def _interrupted(self, message: Interrupted) -> None:
        """Stop at once; with `drain`, hand out nothing more and stop when the attempts under way have ended."""
        drain = self._drain if message.drain is None else message.drain
        if not drain or self._draining is not None:
            self._stop = message.signal
            return
        self._draining, count = message.signal, machine.under_way(self._state)
        self._print_line(f"draining: {count:,} rollouts are under way; a second signal stops at once")

    def _tick(self, now: float) -> None:
        self._next_tick = now + TICK
        self._journal.check_place()  # at once, and not after a week of rollouts that nothing keeps
        for news in (*(self._fleet.tend() if self._fleet is not None else ()), *self._routers.reminder(now)):
            self._print_line(news)
        self._lines.summarise()
        # The end of the last wait for messages: neither what came since nor the decoding of a result is silence.
        self._events.append(events.Tick(min(now, self._results.undecided_since)))
        self._settle()
        self._outbox.set_intervals(self._roster.new_intervals(self._state.limits.hung_after))
        self._show()

    def _settle(self) -> None:
        """Step the dispatch machine until no event is left; an action may add events, which wait for their turn."""
        while self._events:
            self._state, actions = machine.advance(self._state, self._events.popleft())
            for action in actions:
                self._act(action)
        self._results.clear()  # also those that the machine did not record: megabytes each

    def _act(self, action: events.Action) -> None:
        """Carry out an action of the dispatch machine; messages are kept until the commit."""
        match action:
            case events.Record(worker, attempt):
                # With the last damaged file the rollouts come back that were open before a restart.
                resumed = self._ledger.restores(first_of(attempt.rollout))
                for failed in self._results.failed(worker, attempt):
                    self._lines.failed(failed)
                self._demand(self._results.record(worker, attempt), resumed=resumed)
            case events.Start(worker, attempt):
                state = self._roster.admitted(worker)
                assert state is not None, "the dispatch machine has admitted workers only"
                # Before its assignment leaves: after a restart only an attempt that is recorded can be adopted.
                self._journal.attempts.started(attempt, worker, state.host, state.pid)
                self._outbox.assign(worker, attempt, self._results.request(attempt.rollout))
            case events.Resend(worker, attempt):
                self._outbox.assign(worker, attempt, self._results.request(attempt.rollout))
            case events.Revoke() | events.Acknowledge() | events.Dismiss():
                self._outbox.answer(action)
            case events.Fail(worker, attempt, failure):
                self._journal.attempts.ended(attempt, worker, failure)
                self._lines.failed(action)
            case events.GiveUp(worker):
                if self._fleet is not None and self._fleet.kill(worker):
                    # Before its token is gone, so that nothing is assigned to it.
                    self._events.append(events.WorkerDown(time.monotonic(), worker, replaced=True))
            case events.Poison():
                self._poisoned = action
            case _:
                note(action, self._journal.attempts, self._print_line)

    def _demand(self, work: Work, *, resumed: bool = False) -> None:
        """Want rollouts, or no longer; those that are `resumed` may have attempts before."""
        if work.unwanted:
            self._events.append(events.Unwanted(time.monotonic(), tuple(work.unwanted)))
        if work.wanted:
            self._want([self._results.work(each) for each in work.wanted], resumed=resumed)

    def _want(self, wanted: Sequence[WorkId], *, resumed: bool) -> None:
        past = earlier(self._journal, wanted, self._state.limits.deadline) if resumed else NOTHING_BEFORE
        compared = frozenset(each for each in wanted if self._review.compares(each))
        avoid = self._results.recorders(wanted)
        self._events.append(past.wanted(time.monotonic(), wanted, avoid, compared))

    def _send(self) -> None:
        """Send what the turn has decided, then end the run if the turn has decided that."""
        # Also before it ends: results of this turn are durable, and their workers may drop them.
        self._outbox.send()
        if self._stop is not None:
            raise Stopped(self._stop)
        if self._poisoned is not None:
            ends = self._fleet.ended if self._fleet is not None else {}
            request = alone(self._results.request(self._poisoned.rollout))
            text = poison_text(self._poisoned, request, self._ledger, self._journal.origin.system, ends)
            raise PoisonedError(text, request if rollouts_of(self._poisoned.rollout) == 1 else None)

    def _print_line(self, line: str) -> None:
        for listener in self._listeners:
            listener.print_line(line)

    def _show(self) -> None:
        status = _status(self._ledger, self._state, self._roster, self._routers, self._outlooks, started=self._started)
        status = replace(status, loop=LoopFigures(self.inbox.waiting, self._journal.commits, self._done))
        for listener in self._listeners:
            listener.show(status)


def _resumed(state: DispatchState, at: float, *, local: bool, elsewhere: bool) -> DispatchState:
    """Return the first state after a restart, for `local` workers and those that connect from `elsewhere`."""
    # The latter may be busy since before it; local ones have just started.
    hold = 0.0 if local else at + ADOPTION
    return replace(state, hold_until=hold, alone_from=at + ADOPTION + state.limits.others_within if elsewhere else 0.0)


def _received(inbox: Inbox[Message], tick: float, took: float, under_way: int) -> tuple[list[Message], float]:
    """Wait for the next message or `tick`; return messages, and the time up to which they are all that came.

    After a turn that `took` longer than the wait for the next result, more of those `under_way` are waited for.
    """
    messages: list[Message] = []
    began, until, results = time.monotonic(), tick, 0
    while len(messages) < TURN:
        now = time.monotonic()
        wait = max(0.0, until - now)
        try:
            messages.append(inbox.get(wait))
        except queue.Empty:
            return messages, now + wait
        results += isinstance(messages[-1], Result)
        if not 0 < results < under_way:
            until = 0.0
        elif until == tick:
            now = time.monotonic()
            until = now + min(GATHERING, took / 4) if now - began < took else 0.0
    # The inbox may contain more: time is complete only up to the place of the last message taken.
    return messages, inbox.complete


def _status(
    ledger: Ledger, state: DispatchState, roster: Roster, routers: Routers, outlooks: PlannedOutlooks, *, started: float
) -> RunStatus:
    now = time.monotonic()
    return RunStatus(
        ledger.config,
        {
            name: replace(
                progress := account.progress, planned=outlooks.of(account.plan, ledger.methods[name], progress)
            )
            for name, account in ledger.accounts.items()
        },
        {name: each.progress for name, each in ledger.series.items() if closing_check(name)},
        _phases(state),
        roster.records,
        ledger.arrived,
        sum(map(rollouts_of, state.waiting)),
        now - started,
        machine.under_way(state),
        link=routers.link(now),
    )


def _phases(state: DispatchState) -> dict[str, str]:
    now = time.monotonic()
    aside = out_of_favour(state, now)
    return {
        name: "set aside" if name in aside else _shown_phase(state, worker, now)
        for name, worker in state.workers.items()
        if not worker.leaving  # it is no part of the fleet any more, and its end is no trouble
    }


def _shown_phase(state: DispatchState, worker: Worker, now: float) -> str:
    if worker.phase != "gone":
        return worker.phase
    # Without a link nothing is known of a worker, and nothing is wrong with it.
    if not state.linked:
        return "out of reach"
    return worker.resumes_as if now - worker.gone_at < UNNOTICED else "gone"


def _dispatch_limits(file: CampaignConfig) -> Limits:
    return Limits(hung_after=file.hung_after, deadline=file.deadline, max_attempts=file.max_attempts)


class StopRequests:
    """A listener that examines the run directory at every tick, and hands a request to `put`, the loop's own inbox."""

    def __init__(self, directory: Path, print_line: Callable[[str], None]) -> None:
        self.put: Callable[[Interrupted], None] | None = None
        self._directory, self._print_line = directory, print_line

    def print_line(self, line: str) -> None:
        """Drop the line: another listener prints it."""

    def show(self, status: RunStatus) -> None:  # noqa: ARG002
        """Take a request, if there is one."""
        manner = take_request(self._directory)
        if manner is None or self.put is None:
            return
        self._print_line("`perfbound stop` has asked for the end of this run")
        # As Ctrl-C: a library gets its KeyboardInterrupt, and a command ends with 130.
        self.put(Interrupted(signal.SIGINT, drain=manner == "drain"))
