"""Apart from the service: how long its loop waits for the messages of one turn."""

import math
import queue
from typing import Any

import pytest

from perfbound.orchestrator.fleet.link.transport import Result
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.service import TURN, _received
from perfbound.schemas.link.messages import ResultHeader

HEADER = ResultHeader(rollout="robustness.0.nominal.0", attempt=1, worker="w", outcome="done")
RESULT = Result(0.0, "w", HEADER, b"")


class Queued:
    """Messages that are there when they are asked for, and the longest wait that was allowed for each."""

    def __init__(self, *messages: object) -> None:
        self.messages, self.waits, self.complete = list(messages), list[float](), 7.0

    def get(self, wait: float) -> Any:
        """Return the next one."""
        self.waits.append(wait)
        if not self.messages:
            raise queue.Empty
        return self.messages.pop(0)


def taken(inbox: Any, *, took: float, under_way: int) -> list[object]:
    messages, _ = _received(inbox, math.inf, took, under_way)
    return list(messages)


@pytest.mark.parametrize(
    ("took", "under_way", "waits"),
    [(math.inf, 3, True), (0.0, 3, False), (math.inf, 1, False)],
    ids=["a busy loop", "an idle loop", "nothing more to come"],
)
def test_a_busy_loop_waits_a_little_for_more_results(
    monkeypatch: pytest.MonkeyPatch, took: float, under_way: int, *, waits: bool
) -> None:
    monkeypatch.setattr(service, "GATHERING", 1e6)  # a pause of this process shall not end it
    inbox = Queued(RESULT)
    assert taken(inbox, took=took, under_way=under_way) == [RESULT]
    assert inbox.waits[0] == math.inf
    assert len(inbox.waits) == 2
    assert (0.0 < inbox.waits[1] <= 1e6) if waits else (inbox.waits[1] == 0.0)


def test_the_wait_is_no_longer_than_one_for_all_of_them() -> None:
    inbox = Queued(RESULT, RESULT)
    assert taken(inbox, took=math.inf, under_way=2) == [RESULT, RESULT]
    assert inbox.waits[-1] == 0.0, "all that are under way have come"


def test_a_turn_has_a_limit() -> None:
    inbox = Queued(*[RESULT] * 2 * TURN)
    messages, complete = _received(inbox, math.inf, math.inf, 10_000)  # type: ignore[arg-type]
    assert (len(messages), complete) == (TURN, 7.0)
