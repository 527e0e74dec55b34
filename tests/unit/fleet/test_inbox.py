"""Messages and results that wait: bounded for each worker and in all, and given back when they are handled."""

import gc
import queue
import threading

import pytest

from perfbound.orchestrator.fleet import inbox as module
from perfbound.orchestrator.fleet.inbox import Budget, Inbox
from perfbound.orchestrator.fleet.transport import Garbage, Inbound, Result, Token
from perfbound.schemas.errors import MessageError
from perfbound.schemas.messages import ResultHeader

HEADER = ResultHeader(rollout="maximum.0.true.0", attempt=1, worker="w", outcome="done", sha256="a" * 64)


def taken(inbox: Inbox[Inbound]) -> list[Inbound]:
    found: list[Inbound] = []
    while True:
        try:
            found.append(inbox.get(0.0))
        except queue.Empty:
            return found


def test_a_flood_of_one_worker_leaves_room_for_the_others() -> None:
    inbox: Inbox[Inbound] = Inbox()
    for number in range(10_000):
        inbox.put(Garbage(float(number), "flood", "x"))
    inbox.put(Token(0.0, "good", alive=True))
    found = taken(inbox)
    assert len(found) == module.MESSAGES_OF_WORKER + 1
    assert found[-1] == Token(0.0, "good", alive=True)
    assert [message.at for message in found[:-1]] == sorted(message.at for message in found[:-1])
    inbox.put(Garbage(0.0, "flood", "x"))
    assert len(taken(inbox)) == 1, "what was handled makes room"
    assert not inbox._waiting


def test_names_without_end_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MESSAGES", 50)
    inbox: Inbox[Inbound] = Inbox()
    for number in range(1000):
        inbox.put(Garbage(0.0, f"w{number}", "x"))
    assert len(inbox._waiting) == len(taken(inbox)) == 50


def test_a_signal_always_finds_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MESSAGES", 0)
    inbox: Inbox[object] = Inbox()
    inbox.put("a signal")
    assert inbox.get(0.0) == "a signal"


def test_results_count_until_nothing_holds_them() -> None:
    budget = Budget(of_worker=100, whole=150)
    budget.reserve("w", 60)
    result = Result(0.0, "w", HEADER, b"x" * 60)
    budget.release_with(result, 60)
    with pytest.raises(MessageError, match="a result of 50 bytes was dropped unread"):
        budget.reserve("w", 50)
    budget.reserve("v", 90)
    with pytest.raises(MessageError, match="dropped unread"):
        budget.reserve("u", 10)
    assert budget.held == 150
    kept = {"admitted": result}
    del result
    assert budget.held == 150
    kept.clear()
    gc.collect()
    assert budget.held == 90
    budget.reserve("w", 60)


def test_many_threads_leave_nothing_behind() -> None:
    budget = Budget()

    def work() -> None:
        for _ in range(500):
            budget.reserve("w", 10)
            budget.release_with(Result(0.0, "w", HEADER, b""), 10)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    gc.collect()
    assert budget.held == 0
