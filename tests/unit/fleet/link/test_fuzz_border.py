"""Random and mutated bytes at the borders of a run: only the documented errors, and bounded texts.

PERFBOUND_FUZZ sets the number of inputs of each border (see `tests.fuzz.amount`); the seed is fixed without it.
"""

import contextlib
import hashlib
import random
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest
import zenoh

from perfbound.orchestrator.campaign.admission import admit
from perfbound.orchestrator.fleet.link import transport
from perfbound.orchestrator.fleet.link.inbox import Budget
from perfbound.orchestrator.fleet.link.transport import Garbage, Inbound, Linked, RouterToken
from perfbound.schemas.errors import LONGEST_EXCERPT, EvidenceError, MessageError, TrajectoryError
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.ends import OrchestratorEnd
from perfbound.schemas.link.messages import (
    PROTOCOL,
    Ack,
    Assign,
    ResultHeader,
    WorkerState,
    decode_header,
    decode_request,
    decode_state,
    encode_message,
)
from perfbound.schemas.link.seal import Sealer, Stream, StreamName
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.trajectory.trajectory import read_mcap
from perfbound.workers.simulate import run_request
from perfbound.workers.systems import load_system
from tests.fuzz.amount import CHOSEN, inputs

RNG = random.Random(None if CHOSEN else 7)
SPEC = load_system("test-function").spec
REQUEST = RequestTemplate.of(SPEC, {}, horizon=0.0, visual=False).request(
    RolloutId("maximum", 0, "true", 0), [parameter.low for parameter in SPEC.parameters], 1
)
FILE = run_request(REQUEST, lambda _: None)
COLUMNS = tuple(column.name for column in SPEC.columns)
NAME = REQUEST.rollout
STATE = WorkerState(
    protocol=PROTOCOL, version="1", worker="w", host="h", pid=1, systems={"s": "d" * 64}, state="busy", rollout=NAME
)
HEADER = ResultHeader(rollout=NAME, attempt=1, worker="w", outcome="failed", error="it raised", kind="system")
HEADER_BYTES = encode_message(HEADER)
NUMBERS = [b"NaN", b"Infinity", b"1e999", b"-1", b"9" * 400, b"1.5e308", b"9223372036854775808", b"null", b'"1"', b"[]"]


def mutated(seed: bytes) -> bytes:
    """Return bytes like `seed`: flipped, cut, repeated, spliced, with other numbers, or nothing of it at all."""
    data = bytearray(seed)
    for _ in range(RNG.randint(1, 4)):
        at, size = RNG.randrange(len(data) + 1), RNG.randint(0, 40)
        match RNG.randrange(7):
            case 0 if data:
                data[at % len(data)] ^= 1 << RNG.randrange(8)
            case 1:
                del data[at:]
            case 2:
                data[at:at] = data[at : at + size] * RNG.choice([1, 2, 100])
            case 3:
                data[at : at + size] = RNG.randbytes(size)
            case 4:
                data[at : at + 8] = RNG.choice([0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1]).to_bytes(8, "little")
            case 5 if any(digits := [i for i, byte in enumerate(data) if 48 <= byte <= 57]):
                where = RNG.choice(digits)
                data[where : where + 1] = RNG.choice(NUMBERS)
            case _:
                del data[at : at + size]
    return bytes(data) if RNG.random() < 0.95 else RNG.randbytes(RNG.randint(0, 200))


@pytest.mark.parametrize(
    ("decode", "seed"),
    [
        (decode_state, encode_message(STATE)),
        (decode_header, encode_message(HEADER)),
        (decode_request, encode_message(Assign(attempt=1, secret="0" * 64, request=REQUEST))),
        (decode_request, encode_message(Ack(rollout=NAME, attempt=1))),
    ],
    ids=["state", "header", "assign", "ack"],
)
def test_messages(decode: Callable[[bytes], Any], seed: bytes) -> None:
    decode(seed)
    for _ in inputs():
        found, refused = None, ""
        try:
            found = decode(mutated(seed))
        except MessageError as error:
            refused = str(error)
        assert found is None or decode(encode_message(found)) == found
        assert len(refused) <= LONGEST_EXCERPT
        assert refused.isprintable()


def resealed(data: bytes) -> bytes:
    """Return a file with true checksums in half of the cases, so that what is behind them is read."""
    footer = len(data) - 8 - 29
    if RNG.random() < 0.5 or footer < 0:
        return data
    summary = int.from_bytes(data[footer + 9 : footer + 17], "little")
    if not 13 <= summary <= footer:
        return data
    end = summary - 13
    whole = data[:end] + b"\x0f" + (4).to_bytes(8, "little") + zlib.crc32(data[:end]).to_bytes(4, "little")
    tail = data[summary : footer + 25]
    return whole + tail + zlib.crc32(tail).to_bytes(4, "little") + data[footer + 29 :]


def test_a_file_with_its_checksums_is_the_file() -> None:
    assert {resealed(FILE) for _ in range(20)} == {FILE}


def test_files() -> None:
    admit(REQUEST, COLUMNS, FILE, hashlib.sha256(FILE).hexdigest())
    for _ in inputs():
        data = resealed(mutated(FILE))
        with contextlib.suppress(TrajectoryError):
            read_mcap(data)
        with contextlib.suppress(EvidenceError):
            admit(REQUEST, COLUMNS, data, hashlib.sha256(data).hexdigest())


@dataclass
class Sample:
    """A message of the link, as a reader sees it."""

    key_expr: str
    payload: zenoh.ZBytes
    attachment: zenoh.ZBytes | None
    kind: Any = field(default_factory=lambda: zenoh.SampleKind.PUT)


def test_readers_of_the_link() -> None:
    budget, end = Budget(), OrchestratorEnd(None, "r")
    readers: dict[str, tuple[StreamName, transport.Read]] = {
        key_expressions.state_key("r", "w"): ("state", transport._heartbeat),
        key_expressions.result_key("r", "w", NAME, 1): ("result", partial(transport._result, budget)),
        key_expressions.live_worker("r", "w"): ("state", transport._token),
    }
    for key, (stream, read) in readers.items():
        received: list[Inbound] = []
        sealer = Sealer(Stream(b"", "r", end.name, stream))
        samples = [_sample(key, sealer, stream) for _ in inputs()]
        transport._pump(samples, read, end, received.append)
        # Of those without a valid seal some are reported; all others are read.
        assert len(samples) // 4 < len(received) <= len(samples)
        for message in received:
            assert not isinstance(message, RouterToken | Linked)
            assert len(message.worker) <= 100
            assert message.worker.isprintable()
            assert not isinstance(message, Garbage) or len(message.reason) <= LONGEST_EXCERPT
    del received, message
    assert budget.held == 0


def _sample(key: str, sealer: Sealer, stream: StreamName) -> Any:
    name = RNG.choice(["w", "w", "", "\x1b[2J", "x" * 5000, "ü/ü"])
    payload, header = mutated(encode_message(STATE)), RNG.choice([mutated(encode_message(HEADER)), HEADER_BYTES])
    text = payload if stream == "state" else header
    sealed = sealer.seal(name, text) + (b"" if stream == "state" else header)
    attachment = RNG.choice([None, mutated(sealed), sealed, sealed, sealed])
    return Sample(
        key.replace("/w", f"/{name}", 1),
        zenoh.ZBytes(payload),
        None if attachment is None else zenoh.ZBytes(attachment),
    )
