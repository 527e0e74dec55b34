"""The ends of attempts that a worker keeps until the orchestrator has acknowledged them."""

import hashlib
import threading
import time
from dataclasses import dataclass
from typing import Any, Literal

from ..schemas.failure import Failure
from ..schemas.messages import Assign, ResultHeader
from ..schemas.seal import result_proof
from .transport import Uplink

Key = tuple[str, int]
"""Rollout and number of an attempt."""
End = bytes | Failure | Literal["handed_back"]
"""The trajectory's file, or why there is none."""


@dataclass
class _Parcel:
    header: ResultHeader
    payload: bytes
    sent_at: float = float("-inf")


class Parcels:
    """Results that are not acknowledged; any thread may use it."""

    def __init__(self, worker: str, uplink: Uplink) -> None:
        self._worker, self._uplink = worker, uplink
        self._lock = threading.Lock()
        self._waiting: dict[Key, _Parcel] = {}
        self.emptied_at = time.monotonic()
        """When the last one was acknowledged."""

    def __len__(self) -> int:
        return len(self._waiting)

    def __contains__(self, key: Key) -> bool:
        return key in self._waiting

    def add(self, assign: Assign, found: End, **spent: float) -> None:
        """Keep the end of an attempt, which `deliver` delivers; `spent` are the seconds of its header."""
        rollout, attempt = key = key_of(assign)
        named = {"rollout": rollout, "attempt": attempt, "worker": self._worker}
        header = ResultHeader.model_validate({**named, **_end_fields(found), **spent})
        header = header.model_copy(update={"proof": result_proof(assign.secret, header)})
        with self._lock:
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
        """Deliver what is new, and again what was delivered so many s ago."""
        now = time.monotonic()
        with self._lock:
            late = [parcel for parcel in self._waiting.values() if now - parcel.sent_at >= again_after]
            for parcel in late:
                parcel.sent_at = now
        for parcel in late:
            self._uplink.deliver(parcel.header, parcel.payload)


def key_of(assign: Assign) -> Key:
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
