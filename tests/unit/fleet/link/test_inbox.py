"""Messages and results that wait: bounded for each worker and in all, and given back when they are handled."""

import gc
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from perfbound.orchestrator.fleet.link import inbox as module
from perfbound.orchestrator.fleet.link.inbox import Budget, Inbox
from perfbound.orchestrator.fleet.link.transport import Garbage, Heartbeat, Inbound, Result, Token
from perfbound.schemas.errors import MessageError
from perfbound.schemas.link.messages import PROTOCOL, ResultHeader, WorkerState
from tests.fakes.interleaving import meanwhile

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


def a_heartbeat(at: float, worker: str, progress: int) -> Heartbeat:
    state = WorkerState(
        protocol=PROTOCOL, version="1", worker=worker, host="h", pid=1, systems={}, state="busy", progress=progress
    )
    return Heartbeat(at, worker, state)


def test_of_the_heartbeats_of_a_worker_the_newest_waits_in_the_place_of_the_first() -> None:
    inbox: Inbox[Inbound] = Inbox()
    for number in range(1000):
        inbox.put(a_heartbeat(number, "a", number))
        inbox.put(a_heartbeat(number + 0.5, "b", number))
    inbox.put(Token(1000.0, "c", alive=True))
    inbox.put(a_heartbeat(1001.0, "a", 1001))
    assert inbox.waiting == 3
    assert taken(inbox) == [
        a_heartbeat(1001.0, "a", 1001),
        a_heartbeat(999.5, "b", 999),
        Token(1000.0, "c", alive=True),
    ]
    inbox.put(a_heartbeat(1002.0, "a", 1002))
    assert taken(inbox) == [a_heartbeat(1002.0, "a", 1002)], "what was taken is not replaced"
    assert (inbox._newest, inbox._waiting) == ({}, {})


def test_time_is_complete_up_to_the_place_of_a_heartbeat_not_up_to_its_replacement() -> None:
    """Behind it may wait the progress of a worker that would count as hung."""
    inbox: Inbox[Inbound] = Inbox()
    inbox.put(a_heartbeat(1.0, "a", 1))
    inbox.put(a_heartbeat(2.0, "b", 1))
    inbox.put(a_heartbeat(90.0, "a", 2))
    assert (inbox.get(0.0).at, inbox.complete) == (90.0, 1.0)
    assert (inbox.get(0.0).at, inbox.complete) == (2.0, 2.0)


def test_a_repeat_of_a_result_that_waits_is_dropped_and_another_result_is_not() -> None:
    inbox: Inbox[Inbound] = Inbox()
    result, repeat = (Result(at, "w", HEADER, b"x") for at in (1.0, 2.0))
    others = [
        Result(3.0, "v", HEADER, b"x"),
        Result(3.0, "w", HEADER.model_copy(update={"attempt": 2}), b"x"),
        Result(3.0, "w", HEADER.model_copy(update={"proof": "b" * 64}), b"x"),
    ]
    for each in (result, *others, repeat):
        inbox.put(each)
    found = taken(inbox)
    assert len(found) == 4
    assert found[0] is repeat
    inbox.put(result)
    assert taken(inbox) == [result], "it may have been refused"


def test_a_flood_of_heartbeats_takes_one_place() -> None:
    inbox: Inbox[Inbound] = Inbox()
    for number in range(10_000):
        inbox.put(a_heartbeat(number, "flood", number))
    inbox.put(Garbage(0.0, "flood", "x"))
    assert [type(each) for each in taken(inbox)] == [Heartbeat, Garbage]


def test_readers_and_the_loop_lose_no_worker() -> None:
    """Whatever the order, the last heartbeat of each worker arrives."""
    inbox: Inbox[Inbound] = Inbox()
    newest: dict[str, float] = {}

    def read(worker: str) -> None:
        for number in range(2000):
            inbox.put(a_heartbeat(number, worker, number))

    threads = [threading.Thread(target=read, args=(f"w{number}",)) for number in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) or inbox.waiting:
        newest.update({each.worker: each.at for each in taken(inbox) if isinstance(each, Heartbeat)})
    assert newest == {f"w{number}": 1999 for number in range(4)}
    assert (inbox._newest, inbox._waiting) == ({}, {})


class Key:
    """A key, equal to every other, with something that happens when it is looked up for the second time."""

    def __init__(self, then: Callable[[], object]) -> None:
        self._then, self._looks = then, 0

    def __eq__(self, other: object) -> bool:
        return True

    def __hash__(self) -> int:
        self._looks += 1
        if self._looks == 2:
            self._then()
        return 0


@dataclass(frozen=True)
class Replacing:
    """A message of a worker that replaces the one before."""

    at: float
    replaces: Key
    worker: str = "w"


def test_a_message_is_not_lost_that_comes_while_the_one_before_is_taken() -> None:
    inbox: Inbox[Replacing] = Inbox()
    found: list[Replacing] = []
    threads: list[threading.Thread] = []
    inbox.put(Replacing(1.0, Key(lambda: None)))
    # It has found the one before, whose place it takes now.
    inbox.put(Replacing(2.0, Key(lambda: threads.append(meanwhile(lambda: found.append(inbox.get(0.0)))))))
    threads[0].join()
    assert [each.at for each in found] == [2.0]


@pytest.mark.rest
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


@pytest.mark.rest
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


class Size(int):
    """Bytes of a result, with something that happens when they are first added or subtracted."""

    then: Callable[[], object] | None = None

    def __radd__(self, other: int) -> int:
        self._happen()
        return other + int(self)

    def __rsub__(self, other: int) -> int:
        self._happen()
        return other - int(self)

    def _happen(self) -> None:
        then, self.then = self.then, None
        if then is not None:
            then()


def test_two_results_that_come_together_take_no_more_room_than_there_is() -> None:
    budget, size, refused = Budget(of_worker=100), Size(60), list[MessageError]()
    threads: list[threading.Thread] = []

    def reserve() -> None:
        try:
            budget.reserve("w", 60)
        except MessageError as error:
            refused.append(error)

    size.then = lambda: threads.append(meanwhile(reserve))
    budget.reserve("w", size)
    threads[0].join()
    assert (budget.held, len(refused)) == (60, 1)


def test_a_result_that_is_freed_while_room_is_made_for_another_holds_nothing_up() -> None:
    """As the garbage collector frees one: in the thread that is about to count, and holds the lock."""
    budget, size, waiting = Budget(), Size(10), [Result(0.0, "w", HEADER, b"")]
    budget.reserve("w", 60)
    budget.release_with(waiting[0], 60)
    size.then = waiting.clear
    thread = meanwhile(lambda: budget.reserve("w", size))
    assert not thread.is_alive()
    assert (waiting, budget.held) == ([], 10)
