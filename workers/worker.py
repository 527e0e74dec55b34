"""The loop of a worker: receive, simulate, deliver; a result is kept until the orchestrator has acknowledged it."""

import os
import queue
import threading
import time
from collections.abc import Callable
from typing import Literal

from ..schemas import __version__
from ..schemas.batch import BatchRequest, largest_result
from ..schemas.errors import PerfboundError, RefusedError, ReplacedError
from ..schemas.failure import Failure, FailureKind
from ..schemas.host import host_name
from ..schemas.link.messages import (
    HEARTBEAT,
    PROTOCOL,
    Ack,
    Assign,
    AssignBatch,
    Cancel,
    HeartbeatInterval,
    Refuse,
    Release,
    Request,
    RunFinished,
    WorkerState,
)
from ..schemas.platforms import platform_class
from ..schemas.ranges import within_steps
from ..schemas.rollout import RolloutRequest
from .batch import run_on
from .faults import NOT_OF_SYSTEMS, fault_text
from .parcels import Key, Parcels, key_of
from .simulate import requested_system
from .systems import announced
from .systems.base import Cancelled
from .transport import Uplink


class Heartbeats:
    """When the next heartbeat is due, for a thread that asks every `period` s; any thread may set the interval."""

    def __init__(self, uplink: Uplink, period: float) -> None:
        self._uplink, self._period = uplink, period
        self._orchestrators: list[tuple[str, str]] | None = None
        self._next = float("-inf")
        self.interval = period
        """Seconds."""

    def due(self, *, at_once: bool) -> bool:
        """Whether to send one now, which is then counted as sent; `at_once` whether something has changed."""
        now, orchestrators = time.monotonic(), self._uplink.orchestrators()
        if orchestrators != self._orchestrators:
            # Another one, or this one after the link was down: it has sent no interval, and waits for a report.
            self._orchestrators, self.interval, at_once = orchestrators, self._period, True
        if not at_once and now < self._next:
            return False
        # A wait may end a little early, and the heartbeat would be late by another one.
        self._next = now + self.interval - self._period / 2
        return True


RESEND = 1.0
"""Seconds between two deliveries of a result that is not acknowledged."""
POLL, POLL_AT_END = 1.0, 0.1
"""Seconds between two questions whether the run is over for this worker, and while it leaves."""
MOST_PARTS = 1_000
"""Files and packages whose short digests are in every heartbeat."""
SIGNAL_TIME = 0.1
"""Seconds in which a signal that ends a program of the system reaches this worker as well."""
DISMISSAL = 3.0
"""Seconds in which an orchestrator answers a worker that leaves; there may be none, or none that has admitted it."""

EndOfRun = Literal["abandoned", "finished", "left"]
"""Why a worker no longer serves a run: its orchestrator is gone, its certificate is issued, or the worker leaves."""


class WorkerProcess:
    """One worker process: a simulating thread (the caller's) and a heartbeat thread; `receive` is called by a third."""

    def __init__(self, name: str, uplink: Uplink) -> None:
        self.name = name
        self._uplink = uplink
        self._inbox: queue.SimpleQueue[Assign | AssignBatch | Refuse | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._outbox, self._heartbeats = Parcels(name, uplink), Heartbeats(uplink, HEARTBEAT)
        self._accepted: Assign | AssignBatch | None = None
        self._cancelled: Key | None = None
        self._interrupted: Key | None = None
        self._progress: tuple[Key | None, int] = (None, 0)
        self._closed = self._finished = self._dismissed = False
        self._leaving_since: float | None = None
        self._signalled = threading.Event()
        self._urgent = threading.Event()
        specs = announced()
        self._systems = {name: each.digest for name, each in specs.items()}
        self._parts, room = dict[str, tuple[str, ...]](), MOST_PARTS
        for system, each in specs.items():
            if len(each.parts) <= room:  # of more, a refusal names none: heartbeats are many
                self._parts[system] = tuple(each.parts)
                room -= len(each.parts)

    def receive(self, message: Request) -> None:
        """Take a message of the orchestrator; called by the transport's thread."""
        match message:
            case Assign() | AssignBatch():
                self._accept(message)
            case Cancel():
                self._cancelled = (message.rollout, message.attempt)
            case Ack():
                self._outbox.acknowledge((message.rollout, message.attempt))
                if self._leaving_since is not None:
                    self._urgent.set()  # the next heartbeat asks for the dismissal
            case HeartbeatInterval():
                self._heartbeats.interval = message.seconds
            case Refuse():
                self._inbox.put(message)
            case Release():
                self._dismissed = True
                self._inbox.put(None)
            case RunFinished():
                self._finished = True
                # The certificate is issued without them, and nobody acknowledges them any more.
                self._outbox.clear()
                self._drop()
                self._inbox.put(None)

    def leave(self, *, by_signal: bool = False) -> None:
        """Take nothing more: end with the rollout under way, and its result; any thread may call it, also again."""
        if by_signal:
            self._signalled.set()
        if self._leaving_since is None:
            self._leaving_since = time.monotonic()
            self._urgent.set()
            self._inbox.put(None)

    def hand_back(self) -> str | None:
        """Give the rollout under way back to the orchestrator, and return its name; its computation is dropped."""
        assign = self._accepted
        if assign is None or key_of(assign) in self._outbox:
            return None
        self._drop()
        self._outbox.add(assign, "handed_back")
        self._outbox.deliver(RESEND)
        self._urgent.set()
        return assign.request.rollout

    @property
    def has_left(self) -> bool:
        """Whether a worker that leaves has nothing to do or to deliver, and nothing can be on the way to it."""
        if self._leaving_since is None or self._accepted is not None or self._outbox:
            return False
        # Only the heartbeat after the last acknowledgement asks for the dismissal.
        since = max(self._leaving_since, self._outbox.emptied_at)
        return self._dismissed or time.monotonic() - since > DISMISSAL

    def serve(self, abandoned: Callable[[bool], bool]) -> EndOfRun:
        """Simulate what is assigned until `abandoned(outbox is empty)` is true, the run is finished, or it has left.

        Raises:
            RefusedError: the orchestrator refuses this worker.

        """
        heart = threading.Thread(target=self._beat, daemon=True)
        heart.start()
        try:
            while (end := self._end(abandoned)) is None:
                try:
                    message = self._inbox.get(timeout=POLL if self._leaving_since is None else POLL_AT_END)
                except queue.Empty:
                    continue
                if isinstance(message, Refuse):
                    raise RefusedError(message.reason)
                if isinstance(message, Assign | AssignBatch):
                    self._simulate(message)
            return end
        finally:
            self._closed = True
            self._urgent.set()
            heart.join(timeout=1.0)

    def _end(self, abandoned: Callable[[bool], bool]) -> EndOfRun | None:
        if self._finished:
            return "finished"
        if self.has_left:
            return "left"
        return "abandoned" if abandoned(not self._outbox) else None

    def _accept(self, assign: Assign | AssignBatch) -> None:
        key = key_of(assign)
        with self._lock:
            current = self._accepted and key_of(self._accepted)
            if key in self._outbox or (current and key[0] == current[0] and key[1] <= current[1]):
                return  # a repeat, or overtaken by a later attempt
            self._accepted = assign
        self._inbox.put(assign)

    def _simulate(self, assign: Assign | AssignBatch) -> None:
        if self._leaving_since is not None:  # it has not begun
            self.hand_back()
            return
        key = key_of(assign)
        self._progress = (key, 0)
        cpu, wall = time.process_time(), time.monotonic()
        found = self._run(assign.request, key)
        # A system may turn `Cancelled` into an error of its own, or into a trajectory that ends there.
        if self._interrupted == key:
            self._finish(assign)
            return
        spent = {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.monotonic() - wall}
        # A scheduler ends the programs of a system by the same signal, and their ends are no failures of the system.
        ended = isinstance(found, Failure) and found.kind == "system" and self._signalled.wait(SIGNAL_TIME)
        self._outbox.add(assign, "handed_back" if ended else found, **spent)
        self._finish(assign)
        self._outbox.deliver(RESEND)

    def _run(self, request: RolloutRequest | BatchRequest, key: Key) -> bytes | Failure:
        """Return the trajectory's file, or the failure of the attempt."""
        kind: FailureKind = "infrastructure"  # this worker has another system, or none
        try:
            system = requested_system(request)
            # By place, not by type of exception: a system may raise any.
            kind = "system"
            payload = run_on(system, request, lambda step: self._advance(key, step))
        except ImportError as fault:  # this worker lacks a part of the system: it never ran
            return Failure("infrastructure", fault_text(fault))
        except ReplacedError as fault:  # another system: its rollouts say nothing about the one of the campaign
            return Failure("infrastructure", str(fault))
        except PerfboundError as fault:
            return Failure(kind, str(fault) or type(fault).__name__)
        except NOT_OF_SYSTEMS:
            raise
        except BaseException as fault:  # noqa: BLE001  (any: the orchestrator decides on a retry)
            return Failure(kind, fault_text(fault))
        if len(payload) > (most := largest_result(system.spec, request)):
            size = f"{len(payload)} bytes, more than the {most} of a result"
            return Failure("system", f"the trajectory's file has {size}")
        return payload

    def _advance(self, key: Key, step: int) -> None:
        self._progress = (key, within_steps(step))  # a number of the system
        if self._cancelled == key:
            self._interrupted = key
            raise Cancelled

    def _drop(self) -> None:
        """Make nothing of the attempt that is accepted, and perhaps under way."""
        with self._lock:
            if self._accepted is not None:
                self._cancelled = self._interrupted = key_of(self._accepted)
                self._accepted = None

    def _finish(self, assign: Assign | AssignBatch) -> None:
        with self._lock:
            if self._accepted is assign:
                self._accepted = None
        if self._cancelled == key_of(assign):
            self._urgent.set()  # the orchestrator assigns nothing before it knows that this worker is idle

    def _beat(self) -> None:
        reported = None
        while not self._closed:
            urgent = self._urgent.is_set()
            if urgent:  # not cleared otherwise: it may be set between the two lines
                self._urgent.clear()
            current = self._accepted
            # What begins and ends between two looks needs no heartbeat of its own: its result says that it has ended.
            if self._heartbeats.due(at_once=urgent or current is not reported or self._leaving_since is not None):
                self._uplink.report(self._state(current))
                reported = current
            self._outbox.deliver(RESEND)
            self._urgent.wait(HEARTBEAT)

    def _state(self, current: Assign | AssignBatch | None) -> WorkerState:
        running, step = self._progress  # perhaps of an attempt before the accepted one
        return WorkerState(
            protocol=PROTOCOL,
            version=__version__,
            worker=self.name,
            host=host_name(),
            platform=platform_class(),
            pid=os.getpid(),
            systems=self._systems,
            parts=self._parts,
            state="busy" if current else "idle",
            rollout=current.request.rollout if current else None,
            attempt=current.attempt if current else None,
            progress=step if current and running == key_of(current) else 0,
            leaving=True if self._leaving_since is not None else None,
        )
