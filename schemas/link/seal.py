"""The seals of the messages: proof that the sender knows a secret, without the secret itself.

    K       the secret that the processes of a user or of a fleet share; empty where there is none
    a       the secret of one assignment, fresh for each attempt and worker, which only its worker receives
    mac     HMAC-SHA256 over its parts, each behind its length

    seal of a message         counter, mac(mac(K, stream, run, orchestrator, worker), counter, message)
    name of an orchestrator   time and number, mac(K, run, time and number)
    proof of a result         mac(a, every field of its header), among them the sha256 of the payload
    a                         mac(key of the run, run, rollout, attempt, worker)

The names of an orchestrator and of a worker are fresh at each start of a process. So a message of an earlier campaign,
process or direction has a seal of another key, and within one stream each counter counts once: nothing can be replayed.
No clock is involved. Without K every peer can make seals; the proofs and the certificates of the link remain.
"""

import hmac
import itertools
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from ..errors import SealError
from .messages import ResultHeader

StreamName = Literal["request", "state", "result"]
ROUTER = "router"
"""In the place of a run, which has sixteen hexadecimal digits."""
COUNTER, TAG = 8, 32
"""Bytes of the two parts of a seal."""
WINDOW = 64
"""Messages of a stream that may overtake one another; an older one counts as a replay (RFC 4303, section 3.4.3)."""
KNOWN = 10_000
"""Workers whose counters and keys are kept; the one that has been silent for longest is forgotten first."""
PROVED = tuple(sorted(set(ResultHeader.model_fields) - {"proof"}))
"""Fields of a header that its proof covers."""


def mac(key: bytes, *parts: bytes) -> bytes:
    """Return the HMAC-SHA256 of `parts`, which another division of the same bytes does not have.

    >>> mac(b"key", b"ab", b"c") == mac(b"key", b"a", b"bc")
    False
    """
    message = b"".join([len(part).to_bytes(8, "big") + part for part in parts])
    # `hmac.digest` gives up the interpreter's lock each time, for which a busy loop keeps it waiting.
    return hmac.new(key, message, "sha256").digest()


def link_password(secret: bytes) -> str:
    """Return the password of a Zenoh link, from which the secret does not follow."""
    return mac(secret, b"link").hex()


# Orchestrators


def orchestrator_name(secret: bytes, run: str, fresh: str) -> str:
    """Return the name under which an orchestrator of `run` announces itself."""
    return f"{fresh}-{_announced(secret, run, fresh)}"


def is_orchestrator(secret: bytes, run: str, name: str) -> bool:
    """Whether one that knows the secret announces itself under `name`."""
    fresh, _, tag = name.rpartition("-")
    return hmac.compare_digest(tag.encode(), _announced(secret, run, fresh).encode())


def _announced(secret: bytes, run: str, fresh: str) -> str:
    return mac(secret, b"orchestrator", run.encode(), fresh.encode())[:16].hex()


def router_name(secret: bytes, fresh: str) -> str:
    """Return the name under which a router announces itself."""
    return orchestrator_name(secret, ROUTER, fresh)


def is_router(secret: bytes, name: str) -> bool:
    """Whether a router that knows the secret announces itself under `name`."""
    return is_orchestrator(secret, ROUTER, name)


# Messages


@dataclass(frozen=True, slots=True)
class Stream:
    """The messages of one kind between one orchestrator and its workers."""

    secret: bytes
    run: str
    orchestrator: str
    name: StreamName

    def tag(self, worker: str, counter: bytes, message: bytes) -> bytes:
        """Return the second part of a seal."""
        key = _worker_key(self.secret, self.name, self.run, self.orchestrator, worker)
        return mac(key, counter, message)


@lru_cache(maxsize=KNOWN)
def _worker_key(secret: bytes, *names: str) -> bytes:
    return mac(secret, *(name.encode() for name in names))


class Sealer:
    """The sending end of a stream; any thread may use it."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._counter = itertools.count(1)

    def seal(self, worker: str, message: bytes) -> bytes:
        """Return a seal of `message`, which no other one has."""
        counter = next(self._counter).to_bytes(COUNTER, "big")
        return counter + self._stream.tag(worker, counter, message)


class Opener:
    """The receiving end of a stream; for one thread."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._seen: OrderedDict[str, tuple[int, int]] = OrderedDict()
        """Of each worker, the highest counter, and a bit for it and for each of the WINDOW - 1 before it."""

    def check(self, worker: str, seal: bytes, message: bytes) -> None:
        """Accept `message` once.

        Raises:
            SealError: the seal is not one of this message in this stream, or it was accepted before.

        """
        counter, tag = seal[:COUNTER], seal[COUNTER:]
        if not hmac.compare_digest(tag, self._stream.tag(worker, counter, message)):
            raise SealError("its seal is not of this orchestrator, worker and secret")
        self._count(worker, int.from_bytes(counter, "big"))

    def _count(self, worker: str, number: int) -> None:
        highest, bits = self._seen.pop(worker, (0, 0))
        if number > highest:
            highest, bits = number, (bits << min(number - highest, WINDOW) | 1) % 2**WINDOW
            fresh = True
        else:
            bit = 1 << min(highest - number, WINDOW)
            fresh = bit < 2**WINDOW and not bits & bit
            bits |= bit if fresh else 0
        self._seen[worker] = highest, bits
        if len(self._seen) > KNOWN:
            self._seen.popitem(last=False)
        if not fresh:
            raise SealError("it was received before")


# Results


def assignment_secret(key: bytes, run: str, rollout: str, attempt: int, worker: str) -> str:
    """Return the secret of an assignment, as it stands in the message."""
    return mac(key, b"assignment", run.encode(), rollout.encode(), str(attempt).encode(), worker.encode()).hex()


def result_proof(secret: str, header: ResultHeader) -> str:
    """Return the proof that the worker of an assignment made this header; the secret stands for run and attempt."""
    return mac(bytes.fromhex(secret), *(f"{name}={getattr(header, name)!r}".encode() for name in PROVED)).hex()


def is_proved(secret: str, header: ResultHeader) -> bool:
    """Whether the worker of an assignment made this header."""
    return hmac.compare_digest(header.proof, result_proof(secret, header))
