"""Seals: accepted once, and only by the end, in the stream and from the sender for which they were made."""

import itertools
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.errors import SealError
from perfbound.schemas.link import seal
from perfbound.schemas.link.messages import ResultHeader
from perfbound.schemas.link.seal import Opener, Sealer, Stream

STREAM = Stream(b"secret", "run", "orchestrator", "state")


def accepted(opener: Opener, worker: str, tag: bytes, message: bytes) -> bool:
    try:
        opener.check(worker, tag, message)
    except SealError:
        return False
    return True


def test_a_message_is_accepted_once() -> None:
    sealer, opener = Sealer(STREAM), Opener(STREAM)
    tags = [sealer.seal("w", b"m") for _ in range(3)]
    assert [accepted(opener, "w", tag, b"m") for tag in (*tags, *tags)] == [True] * 3 + [False] * 3


@pytest.mark.parametrize(
    "other",
    [
        replace(STREAM, secret=b"another"),
        replace(STREAM, secret=b""),
        replace(STREAM, run="another"),
        replace(STREAM, orchestrator="another"),
        replace(STREAM, name="result"),
        replace(STREAM, name="request"),
        replace(STREAM, run="runo", orchestrator="rchestrator"),
    ],
)
def test_a_seal_of_another_stream_is_none(other: Stream) -> None:
    assert not accepted(Opener(STREAM), "w", Sealer(other).seal("w", b"m"), b"m")


def test_a_seal_of_another_worker_or_message_is_none() -> None:
    tag = Sealer(STREAM).seal("w", b"m")
    opener = Opener(STREAM)
    assert not accepted(opener, "v", tag, b"m")
    assert not accepted(opener, "w", tag, b"n")
    assert not accepted(opener, "w", tag + b"m", b"")
    assert not accepted(opener, "w", (7).to_bytes(seal.COUNTER, "big") + tag[seal.COUNTER :], b"m")
    for end in range(len(tag)):
        assert not accepted(opener, "w", tag[:end], b"m")
    assert accepted(opener, "w", tag, b"m"), "what is refused counts for nothing"


@given(st.lists(st.integers(0, 199), max_size=300))
def test_any_order_of_any_copies_accepts_each_message_at_most_once(order: list[int]) -> None:
    """And every one that is overtaken by fewer than WINDOW others."""
    sealer, opener = Sealer(STREAM), Opener(STREAM)
    tags = [sealer.seal("w", b"m") for _ in range(200)]
    seen: set[int] = set()
    for number in order:
        expected = number not in seen and number > max(seen, default=-1) - seal.WINDOW
        assert accepted(opener, "w", tags[number], b"m") == expected
        seen |= {number} if expected else set()


def test_the_counters_of_one_worker_are_none_of_another_s() -> None:
    sealer, opener = Sealer(STREAM), Opener(STREAM)
    for number in range(500):
        worker = f"w{number % 2}" if number < 400 else "w0"
        assert accepted(opener, worker, sealer.seal(worker, b"m"), b"m")


def test_what_is_known_of_workers_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seal, "KNOWN", 3)
    sealer, opener = Sealer(STREAM), Opener(STREAM)
    for name in map(str, range(9)):
        assert accepted(opener, name, sealer.seal(name, b"m"), b"m")
    assert list(opener._seen) == ["6", "7", "8"]


def test_an_orchestrator_is_known_by_secret_and_run() -> None:
    name = seal.orchestrator_name(b"secret", "run", "1700000000000-0123abcd")
    assert seal.is_orchestrator(b"secret", "run", name)
    assert not seal.is_orchestrator(b"another", "run", name)
    assert not seal.is_orchestrator(b"secret", "another", name)
    for wrong in (name[:-1], f"{name}0", f"2{name[1:]}", "", "-", "é-é", "1700000000000-0123abcd"):
        assert not seal.is_orchestrator(b"secret", "run", wrong)


# Results

SECRET = seal.assignment_secret(b"key", "run", "maximum.0.true.0", 1, "w")
DONE = ResultHeader(
    rollout="maximum.0.true.0",
    attempt=1,
    worker="w",
    outcome="done",
    sha256="a" * 64,
    cpu_seconds=0.1,
    wall_seconds=2.0,
)
FAILED = ResultHeader(rollout="maximum.0.true.0", attempt=1, worker="w", outcome="failed", error="it", kind="system")


def proved(header: ResultHeader, secret: str = SECRET) -> ResultHeader:
    return header.model_copy(update={"proof": seal.result_proof(secret, header)})


@pytest.mark.parametrize("header", [DONE, FAILED])
def test_a_result_is_proved_by_its_assignment_alone(header: ResultHeader) -> None:
    found = ResultHeader.model_validate_json(proved(header).model_dump_json())
    assert seal.is_proved(SECRET, found)
    others = itertools.product(
        (b"key", b"other"), ("run", "other"), ("maximum.0.true.0", "maximum.1.true.0"), (1, 2), "wv"
    )
    for number, parts in enumerate(others):
        assert seal.is_proved(seal.assignment_secret(*parts), found) == (number == 0)
    assert not seal.is_proved(SECRET, header)
    assert SECRET not in found.model_dump_json()


@pytest.mark.parametrize(
    "change",
    [
        {"rollout": "maximum.1.true.0"},
        {"attempt": 2},
        {"worker": "v"},
        {"outcome": "failed"},
        {"sha256": "b" * 64},
        {"error": "another"},
        {"kind": "system"},
        {"cpu_seconds": 0.2},
        {"wall_seconds": 3.0},
    ],
)
def test_a_changed_field_is_not_proved(change: dict[str, object]) -> None:
    assert set(ResultHeader.model_fields) == {*change} | set(DONE.model_dump())
    assert not seal.is_proved(SECRET, proved(DONE).model_copy(update=change))
