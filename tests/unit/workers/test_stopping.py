"""SIGTERM of a worker: what it does with the rollout under way, and in which order it ends."""

import os
import signal
from typing import Any, cast

import pytest

from perfbound.workers import stopping as module
from perfbound.workers.stopping import STOPPED, Stopping


class Worker:
    """A worker whose rollout under way does not end in time."""

    has_left = False

    def __init__(self, events: list[str]) -> None:
        self._events = events

    def leave(self, *, by_signal: bool) -> None:
        self._events.append(f"leaves, by_signal={by_signal}")

    def hand_back(self) -> str:
        self._events.append("hands back")
        return "maximum.0.true.0"


def test_a_rollout_that_does_not_end_in_time_is_handed_back_before_the_worker_ends(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    events: list[str] = []
    monkeypatch.setattr(module, "DELIVERY", 0.0)
    monkeypatch.setattr(os, "_exit", lambda code: events.append(f"exit code {code}"))
    stopping = Stopping(0.0, lambda: events.append("ends programs"))
    stopping.attend(cast("Any", Worker(events)))
    read, write = os.pipe()
    os.write(write, bytes((signal.SIGINT, signal.SIGTERM)))
    stopping._wait(read)
    for each in (read, write):
        os.close(each)
    assert events == ["leaves, by_signal=True", "hands back", "ends programs", f"exit code {STOPPED}"]
    assert capsys.readouterr().err.endswith("perfbound-worker: maximum.0.true.0 is handed back\n")
