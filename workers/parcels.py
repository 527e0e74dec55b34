"""The ends of attempts that a worker keeps until the orchestrator has acknowledged them."""

import hashlib
import threading
import time
from dataclasses import dataclass
from typing import Any, Literal

from ..schemas.failure import Failure
from ..schemas.link.messages import Assign, AssignBatch, ResultHeader
from ..schemas.link.seal import result_proof
from .transport import Uplink

Key = tuple[str, int]
"""Rollout and number of an attempt."""
LONGEST_WAIT = 16.0
"""Seconds between two deliveries of a result."""
End = bytes | Failure | Literal["handed_back"]
"""The trajectory's file, or why there is none."""


@dataclass
class _Parcel:
    header: ResultHeader
    payload: bytes
    sent_at: float = float("-inf")
    wait: float = 0.0
    """Seconds from `sent_at` to the next delivery."""


class Parcels:
    """Results that are not acknowledged; any thread may use it."""

    def __init__(self, worker: str, uplink: Uplink) -> None:
        self._worker, self._uplink = worker, uplink
        self._lock = threading.Lock()
        self._waiting: dict[Key, _Parcel] = {}
        self._announced: list[tuple[str, str]] | None = None
        self.emptied_at = time.monotonic()
        """When the last one was acknowledged."""

    def __len__(self) -> int:
        return len(self._waiting)

    def __contains__(self, key: Key) -> bool:
        return key in self._waiting

    def add(self, assign: Assign | AssignBatch, found: End, **spent: float) -> None:
        """Keep the end of an attempt, which `deliver` delivers; `spent` are the seconds of its header."""
        rollout, attempt = key = key_of(assign)
        named = {"rollout": rollout, "attempt": attempt, "worker": self._worker}
        header = ResultHeader.model_validate({**named, **_end_fields(found), **spent})
        # By the secret of the assignment, which its worker alone has: the shared secret would let any worker forge it.
        header = header.model_copy(update={"proof": result_proof(assign.secret, header)})
        with self._lock:
            # The first end stays: the thread that hands an attempt back and the one that simulates it may both come.
            self._waiting.setdefault(key, _Parcel(header, found if isinstance(found, bytes) else b""))

    def acknowledge(self, key: Key) -> None:
        """Drop what the orchestrator has, or does not need."""
        with self._lock:
            self._waiting.pop(key, None)
            self.emptied_at = time.monotonic()

    def clear(self) -> None:
        """Drop everything."""
        with self._lock:
            self._waiting.clear()

    def deliver(self, again_after: float) -> None:
        """Deliver what is new, and again what was delivered `again_after` s ago, then after twice as long each time.

        An orchestrator that is busy with a thousand results needs longer than that for each of them, and would get all
        of them again and again. One that is announced anew, also after a link was down, gets them soon.
        """
        now, announced = time.monotonic(), self._uplink.orchestrators()
        with self._lock:
            if announced != self._announced:
                self._announced = announced
                for parcel in self._waiting.values():
                    parcel.wait = min(parcel.wait, again_after)
            late = [parcel for parcel in self._waiting.values() if now - parcel.sent_at >= parcel.wait]
            for parcel in late:
                parcel.sent_at, parcel.wait = now, min(LONGEST_WAIT, max(again_after, 2 * parcel.wait))
        for parcel in late:
            self._uplink.deliver(parcel.header, parcel.payload)


def key_of(assign: Assign | AssignBatch) -> Key:
    """Return the attempt of an assignment."""
    return assign.request.rollout, assign.attempt


def _end_fields(found: End) -> dict[str, Any]:
    """Return the part of a header that says how an attempt ended."""
    if isinstance(found, Failure):
        return {"outcome": "failed", "error": _utf8(found.reason), "kind": found.kind}
    if isinstance(found, bytes):
        return {"outcome": "done", "sha256": hashlib.sha256(found).hexdigest()}
    return {"outcome": found}


def _utf8(reason: str) -> str:
    """Return a reason as a header takes it: a file name in it may be no UTF-8."""
    return reason.encode(errors="backslashreplace").decode()
