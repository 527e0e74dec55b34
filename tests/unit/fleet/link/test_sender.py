"""A peer that does not read: the loop goes on, and the end comes."""

import os
import signal
import threading
import time

import pytest

from perfbound.orchestrator.fleet.children import processes
from perfbound.orchestrator.fleet.link import sender as module
from perfbound.orchestrator.fleet.link.sender import Sender, within_patience
from perfbound.orchestrator.fleet.link.transport import ZenohTransport
from perfbound.orchestrator.report.web import server
from perfbound.orchestrator.run.page import live_page
from perfbound.schemas.link.ends import OrchestratorEnd
from perfbound.schemas.link.messages import Ack, Request
from tests.patience import PATIENCE

ACKS = [Ack(rollout="maximum.0.true.0", attempt=number) for number in range(1, 101)]


def test_messages_leave_in_their_order_and_the_last_ones_before_the_end() -> None:
    sent: list[tuple[str, Request]] = []
    sender = Sender(lambda worker, message: sent.append((worker, message)))
    for ack in ACKS:
        sender.send("w", ack)
    sender.finish()
    assert sent == [("w", ack) for ack in ACKS]


def test_a_peer_that_does_not_read_blocks_no_caller() -> None:
    reading, blocked = threading.Event(), threading.Event()
    sent: list[Request] = []

    def put(_worker: str, message: Request) -> None:
        blocked.set()
        assert reading.wait(PATIENCE)
        sent.append(message)

    sender = Sender(put)
    for ack in ACKS:
        sender.send("w", ack)
    assert blocked.wait(PATIENCE)
    sender.finish()
    within_patience(lambda: reading.wait(PATIENCE))
    assert sent == []
    reading.set()


def test_messages_for_a_peer_that_does_not_read_are_bounded() -> None:
    reading = threading.Event()
    sender = Sender(lambda _worker, _message: assert_read(reading))
    for _ in range(module.WAITING + 100):
        sender.send("w", ACKS[0])
    assert sender._waiting.qsize() <= module.WAITING
    reading.set()


def assert_read(reading: threading.Event) -> None:
    assert reading.wait(PATIENCE)


def test_the_end_of_a_link_has_one_limit_whatever_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    over, waited, join = threading.Event(), list[float | None](), threading.Thread.join

    def noted(thread: threading.Thread, timeout: float | None = None) -> None:
        if threading.current_thread() is threading.main_thread():
            waited.append(timeout)
        join(thread, timeout)

    class Stuck:
        def put(self, *_: object, **__: object) -> None:
            over.wait(PATIENCE)

        close = put

    link = ZenohTransport(Stuck(), "", None)  # type: ignore[arg-type]
    link.end = OrchestratorEnd(None, "run")
    reader = threading.Thread(target=over.wait, args=(PATIENCE,))
    link._threads.append(reader)
    reader.start()
    link.send("w", ACKS[0])
    monkeypatch.setattr(threading.Thread, "join", noted)
    link.close()
    monkeypatch.undo()
    over.set()
    reader.join()
    assert waited == [module.PATIENCE]


def test_all_that_is_waited_for_after_the_last_rollout_takes_less_than_three_seconds() -> None:
    # The end of the link is a part of the page's time.
    assert module.PATIENCE <= live_page.GRACE
    assert server.SHUTDOWN < live_page.GRACE
    assert processes.GRACE + live_page.GRACE <= 2.5


def test_an_error_at_the_end_is_none_of_the_campaign() -> None:
    def close() -> None:
        raise RuntimeError("the session does not close")

    within_patience(close)


@pytest.mark.integration
def test_a_signal_does_not_interrupt_the_end_of_a_link() -> None:
    closed = threading.Event()

    def close() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.3)
        closed.set()

    with pytest.raises(KeyboardInterrupt):
        within_patience(close)
    assert closed.is_set()
