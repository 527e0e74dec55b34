"""The loop of a worker: receive, simulate, deliver; a result is kept until the orchestrator has acknowledged it."""

import hashlib
import os
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ..schemas import __version__
from ..schemas.errors import PerfboundError, RefusedError
from ..schemas.failure import Failure, FailureKind
from ..schemas.messages import (
    MAX_RESULT,
    PROTOCOL,
    Ack,
    Assign,
    Cancel,
    Refuse,
    Request,
    ResultHeader,
    WorkerState,
)
from ..schemas.platforms import platform_class
from ..schemas.ranges import within_steps
from ..schemas.rollout import RolloutRequest
from ..schemas.seal import result_proof
from ..schemas.system import SystemSpec
from .faults import fault_text
from .simulate import requested_system, run_request_on
from .systems import usable
from .systems.base import Cancelled
from .transport import Uplink

HEARTBEAT = 0.5
RESEND = 1.0
"""Seconds between two deliveries of a result that is not acknowledged."""


Key = tuple[str, int]
"""Rollout and number of an attempt."""


@dataclass
class _Parcel:
    header: ResultHeader
    payload: bytes
    sent_at: float


class WorkerProcess:
    """One worker process: a simulating thread (the caller's) and a heartbeat thread; `receive` is called by a third."""

    def __init__(self, name: str, uplink: Uplink) -> None:
        self.name = name
        self._uplink = uplink
        self._inbox: queue.SimpleQueue[Assign | Refuse] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._outbox: dict[Key, _Parcel] = {}
        self._accepted: Assign | None = None
        self._cancelled: Key | None = None
        self._interrupted: Key | None = None
        self._progress: tuple[Key | None, int] = (None, 0)
        self._leaving = False
        self._changed = threading.Event()
        self._systems = {name: each.identities for name, each in usable().items() if isinstance(each, SystemSpec)}

    def receive(self, message: Request) -> None:
        """Take a message of the orchestrator; called by the transport's thread."""
        match message:
            case Assign():
                self._accept(message)
            case Cancel():
                self._cancelled = (message.rollout, message.attempt)
            case Ack():
                with self._lock:
                    self._outbox.pop((message.rollout, message.attempt), None)
            case Refuse():
                self._inbox.put(message)

    def serve(self, abandoned: Callable[[bool], bool]) -> None:
        """Simulate what is assigned until `abandoned(outbox is empty)` is true.

        Raises:
            RefusedError: the orchestrator refuses this worker.

        """
        heart = threading.Thread(target=self._beat, daemon=True)
        heart.start()
        try:
            while not abandoned(not self._outbox):
                try:
                    message = self._inbox.get(timeout=1.0)
                except queue.Empty:
                    continue
                if isinstance(message, Refuse):
                    raise RefusedError(message.reason)
                self._simulate(message)
        finally:
            self._leaving = True
            self._changed.set()
            heart.join(timeout=1.0)

    def _accept(self, assign: Assign) -> None:
        key = _attempt_key(assign)
        with self._lock:
            current = self._accepted and _attempt_key(self._accepted)
            if key in self._outbox or (current and key[0] == current[0] and key[1] <= current[1]):
                return  # a repeat, or overtaken by a later attempt
            self._accepted = assign
        self._inbox.put(assign)

    def _simulate(self, assign: Assign) -> None:
        key = _attempt_key(assign)
        self._progress = (key, 0)
        self._changed.set()
        cpu, wall = time.process_time(), time.monotonic()
        found = self._run(assign.request, key)
        # A system may turn `Cancelled` into an error of its own, or into a trajectory that ends there.
        if self._interrupted == key:
            self._finish(assign)
            return
        failure, payload = (found, b"") if isinstance(found, Failure) else (None, found)
        header = ResultHeader(
            rollout=key[0],
            attempt=key[1],
            worker=self.name,
            outcome="failed" if failure else "done",
            sha256="" if failure else hashlib.sha256(payload).hexdigest(),
            error=_text(failure.reason) if failure else "",
            kind=failure.kind if failure else None,
            cpu_seconds=time.process_time() - cpu,
            wall_seconds=time.monotonic() - wall,
        )
        header = header.model_copy(update={"proof": result_proof(assign.secret, header)})
        with self._lock:
            self._outbox[key] = _Parcel(header, payload, time.monotonic())
        self._finish(assign)
        self._uplink.deliver(header, payload)

    def _run(self, request: RolloutRequest, key: Key) -> bytes | Failure:
        """Return the trajectory's file, or the failure of the attempt."""
        kind: FailureKind = "infrastructure"  # this worker has another system, or none
        try:
            system = requested_system(request)
            kind = "system"
            payload = run_request_on(system, request, lambda step: self._advance(key, step))
        except ImportError as fault:  # this worker lacks a part of the system: it never ran
            return Failure("infrastructure", fault_text(fault))
        except PerfboundError as fault:
            return Failure(kind, str(fault) or type(fault).__name__)
        except (Exception, SystemExit) as fault:  # noqa: BLE001  (any: the orchestrator decides on a retry)
            return Failure(kind, fault_text(fault))
        if len(payload) > (most := min(MAX_RESULT, system.spec.largest_file)):
            size = f"{len(payload)} bytes, more than the {most} of a result"
            return Failure("system", f"the trajectory's file has {size}")
        return payload

    def _advance(self, key: Key, step: int) -> None:
        self._progress = (key, within_steps(step))  # a number of the system
        if self._cancelled == key:
            self._interrupted = key
            raise Cancelled

    def _finish(self, assign: Assign) -> None:
        with self._lock:
            if self._accepted is assign:
                self._accepted = None
        self._changed.set()

    def _beat(self) -> None:
        while not self._leaving:
            self._uplink.report(self._state())
            self._deliver_again()
            self._changed.wait(HEARTBEAT)
            self._changed.clear()

    def _state(self) -> WorkerState:
        current = self._accepted
        running, step = self._progress  # perhaps of an attempt before the accepted one
        return WorkerState(
            protocol=PROTOCOL,
            version=__version__,
            worker=self.name,
            host=os.uname().nodename,
            platform=platform_class(),
            pid=os.getpid(),
            systems=self._systems,
            state="busy" if current else "idle",
            rollout=current.request.rollout if current else None,
            attempt=current.attempt if current else None,
            progress=step if current and running == _attempt_key(current) else 0,
        )

    def _deliver_again(self) -> None:
        now = time.monotonic()
        with self._lock:
            late = [parcel for parcel in self._outbox.values() if now - parcel.sent_at >= RESEND]
        for parcel in late:
            parcel.sent_at = now
            self._uplink.deliver(parcel.header, parcel.payload)


def _text(reason: str) -> str:
    """Return a reason as a header takes it: a file name in it may be no UTF-8."""
    return reason.encode(errors="backslashreplace").decode()


def _attempt_key(assign: Assign) -> Key:
    return assign.request.rollout, assign.attempt
