"""A peer that does not read: the loop goes on, and the end comes."""

import threading

from perfbound.orchestrator.fleet import sender as module
from perfbound.orchestrator.fleet.sender import Sender, within_patience
from perfbound.schemas.messages import Ack, Request
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


def test_an_error_at_the_end_is_none_of_the_campaign() -> None:
    def close() -> None:
        raise RuntimeError("the session does not close")

    within_patience(close)
