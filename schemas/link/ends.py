"""The two ends of the link: what each sends, with its seal, and what it accepts of the other.

A seal travels in the attachment of a message, before the header of a result, so that a peer of another version still
reads a heartbeat or a refusal. An end has no network: the transports carry its bytes under its keys.
"""

import threading
import time
from typing import NamedTuple

from ..errors import SealError
from . import key_expressions, seal
from .messages import (
    PROTOCOL,
    Request,
    ResultHeader,
    WorkerState,
    decode_header,
    decode_request,
    decode_state,
    encode_message,
)

SEAL = seal.COUNTER + seal.TAG
BY_CERTIFICATE = "-certificate"
"""Before the seal in the name of an orchestrator or router with access rules."""
SHOWN = 5
"""Messages without a valid seal that are reported; a peer that sends more shall not fill the log."""


class Packet(NamedTuple):
    """The bytes of a message; those of a result's file travel beside them."""

    key: str
    payload: bytes
    attachment: bytes


class OrchestratorEnd:
    """The orchestrator of `run`; `state` and `header` are for one thread each, `request` for any.

    With `by_certificate` its name says that it takes workers by the common names of their certificates.
    """

    def __init__(self, secret: bytes | None, run: str, *, by_certificate: bool = False) -> None:
        self._secret, self._run = secret or b"", run
        self.name = seal.orchestrator_name(self._secret, run, fresh_name(by_certificate=by_certificate))
        self._requests = seal.Sealer(self._stream("request"))
        self._states = seal.Opener(self._stream("state"))
        self._results = seal.Opener(self._stream("result"))
        self._rejected = 0

    def request(self, worker: str, message: Request) -> Packet:
        """Return a message to one worker."""
        payload = encode_message(message)
        return Packet(key_expressions.request_key(self._run, worker), payload, self._requests.seal(worker, payload))

    def state(self, worker: str, payload: bytes, attachment: bytes | None) -> WorkerState:
        """Read a heartbeat.

        Raises:
            SealError: the seal is not one of this worker's next messages.
            MessageError: it is not of the protocol.

        """
        if attachment is None and not self._secret and (older := decode_state(payload)).protocol != PROTOCOL:
            return older  # a version without seals: it is refused, which it shall be told
        self._states.check(worker, attachment or b"", payload)
        return decode_state(payload)

    def header(self, worker: str, attachment: bytes | None) -> ResultHeader:
        """Read the header of a result, before anything is done with its file; raises as `state`."""
        attachment = attachment or b""
        self._results.check(worker, attachment[:SEAL], attachment[SEAL:])
        return decode_header(attachment[SEAL:])

    def rejected(self, error: SealError) -> str:
        """Return the line for a message without a valid seal; nothing if enough of them were reported."""
        self._rejected += 1
        more = "; further ones are not reported" if self._rejected == SHOWN else ""
        return f"{error}{more}" if self._rejected <= SHOWN else ""

    def _stream(self, stream: seal.StreamName) -> seal.Stream:
        return seal.Stream(self._secret, self._run, self.name, stream)


def takes_by_certificate(name: str) -> bool:
    """Whether an orchestrator, or router, hears a worker only under the common name of its certificate."""
    return name.rpartition("-")[0].endswith(BY_CERTIFICATE)


def fresh_name(*, by_certificate: bool) -> str:
    """Return what an orchestrator or router calls itself, before the seal."""
    # The time makes names sort by age, and workers without --run join the first.
    return key_expressions.fresh_id(f"{time.time_ns() // 1_000_000:013d}") + (BY_CERTIFICATE if by_certificate else "")


class _Line:
    """What a worker needs to speak with one orchestrator; kept while the worker lives, since its counters continue."""

    def __init__(self, secret: bytes, run: str, orchestrator: str) -> None:
        self.states = seal.Sealer(seal.Stream(secret, run, orchestrator, "state"))
        self.results = seal.Sealer(seal.Stream(secret, run, orchestrator, "result"))
        self.requests = seal.Opener(seal.Stream(secret, run, orchestrator, "request"))


class WorkerEnd:
    """A worker, which serves one run at a time; the orchestrators that it sees come and go."""

    def __init__(self, secret: bytes | None) -> None:
        self._secret = secret or b""
        self._live: dict[str, str] = {}
        self._strangers: set[str] = set()
        self._strict_routers: set[str] = set()
        self._run, self._worker = "", ""
        self._lines: dict[str, _Line] = {}
        self._line: _Line | None = None
        # Tokens come on a thread of their own, also while this worker joins another run.
        self._lock = threading.Lock()

    @property
    def strangers(self) -> bool:
        """Whether an orchestrator is there that does not know the secret."""
        return bool(self._strangers)

    def orchestrators(self) -> list[tuple[str, str]]:
        """Return (orchestrator, run) of all that are alive and know the secret, the oldest first."""
        return sorted(self._live.copy().items())

    def by_certificate(self, orchestrator: str) -> bool:
        """Whether it, or a router, hears this worker only under the common name of its certificate."""
        return takes_by_certificate(orchestrator) or bool(self._strict_routers)

    def router(self, key: str, *, alive: bool) -> None:
        """Take the token of a router, or its end."""
        name = key_expressions.last(key)
        if not alive:
            self._strict_routers.discard(name)
        elif takes_by_certificate(name) and seal.is_router(self._secret, name):
            self._strict_routers.add(name)

    def appear(self, key: str) -> None:
        """Take the token of an orchestrator."""
        run, name = key_expressions.run_of(key), key_expressions.last(key)
        if not seal.is_orchestrator(self._secret, run, name):
            self._strangers.add(key)
            return
        with self._lock:
            self._live[name] = run
            self._attach()

    def disappear(self, key: str) -> None:
        """Take the end of a token."""
        self._strangers.discard(key)
        with self._lock:
            self._live.pop(key_expressions.last(key), None)
            self._attach()

    def join(self, run: str, worker: str) -> None:
        """Serve `run` under the name `worker`."""
        with self._lock:
            self._run, self._worker, self._lines, self._line = run, worker, {}, None
            self._attach()

    def state(self, message: WorkerState) -> Packet | None:
        """Return a heartbeat; None while there is no orchestrator."""
        if (line := self._line) is None:
            return None
        payload = encode_message(message)
        return Packet(
            key_expressions.state_key(self._run, self._worker), payload, line.states.seal(self._worker, payload)
        )

    def result(self, header: ResultHeader, payload: bytes) -> Packet | None:
        """Return a result; None while there is no orchestrator."""
        if (line := self._line) is None:
            return None
        key, text = (
            key_expressions.result_key(self._run, self._worker, header.rollout, header.attempt),
            encode_message(header),
        )
        return Packet(key, payload, line.results.seal(self._worker, text) + text)

    def request(self, payload: bytes, attachment: bytes | None) -> Request:
        """Read a message of the orchestrator.

        Raises:
            MessageError: it is not of the protocol, or not of the orchestrator.

        """
        if (line := self._line) is None:
            raise SealError("no orchestrator is there")
        line.requests.check(self._worker, attachment or b"", payload)
        return decode_request(payload)

    def _attach(self) -> None:
        """Speak with the orchestrator of the run that appeared last: after a restart the one before may linger."""
        serving = [name for name, run in self._live.items() if run == self._run]
        if serving and self._run:
            known = self._lines.get(serving[-1]) or _Line(self._secret, self._run, serving[-1])
            self._lines[serving[-1]] = self._line = known
