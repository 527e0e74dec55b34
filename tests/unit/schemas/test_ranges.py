"""Numbers of messages: each has a range, and what is inside fits the database and the page."""

import json
import sqlite3
from contextlib import closing
from typing import Any

import pytest

from perfbound.schemas.errors import MessageError
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
from perfbound.schemas.ranges import LARGEST_INTEGER, LARGEST_NUMBER, MOST_SECONDS, within_steps
from perfbound.schemas.rollout import RolloutRequest

ROLLOUT = "maximum.0.true.0"
STATE: dict[str, Any] = {
    "protocol": PROTOCOL,
    "version": "1",
    "worker": "w",
    "host": "h",
    "pid": 1,
    "systems": {"s": "d" * 64},
    "state": "busy",
    "rollout": ROLLOUT,
    "attempt": 1,
    "progress": 0,
}
HEADER: dict[str, Any] = {"rollout": ROLLOUT, "attempt": 1, "worker": "w", "outcome": "done", "sha256": "a" * 64}
REQUEST: dict[str, Any] = {
    "campaign": "c",
    "config_sha256": "0" * 64,
    "problem": "maximum",
    "test": 0,
    "variant": "true",
    "replicate": 0,
    "seed": 0,
    "system": "s",
    "spec_sha256": "0" * 64,
    "options": {"gain": 1.0},
    "x": [0.0],
    "horizon": 1.0,
}
ASSIGN: dict[str, Any] = {"type": "assign", "attempt": 1, "secret": "0" * 64, "request": REQUEST}
INTEGERS = {  # the largest that is taken
    ("state", "protocol"): 10**6,
    ("state", "pid"): 2**31 - 1,
    ("state", "attempt"): 10**6,
    ("state", "progress"): LARGEST_INTEGER,
    ("header", "attempt"): 10**6,
    ("assign", "attempt"): 10**6,
    ("request", "test"): 10**9 - 1,
    ("request", "replicate"): 10**6 - 1,
    ("request", "seed"): LARGEST_INTEGER,
}
FLOATS = {
    ("header", "cpu_seconds"): MOST_SECONDS,
    ("header", "wall_seconds"): MOST_SECONDS,
    ("request", "horizon"): MOST_SECONDS,
    ("request", "x"): LARGEST_NUMBER,
    ("request", "options"): LARGEST_NUMBER,
}
OUTSIDE = ["NaN", "Infinity", "-Infinity", "1e999", "1.5e308", "-1.5e308", str(2**63), str(-(2**63)), str(2**70), "-1"]


def decoded(message: str, field: str, number: str) -> WorkerState | ResultHeader | Assign:
    """Read a message in which one number is the text `number`."""
    inner = {"state": STATE, "header": HEADER, "assign": ASSIGN, "request": REQUEST}[message] | {field: "HERE"}
    whole = json.dumps(ASSIGN | {"request": inner} if message == "request" else inner)
    put = {"x": f"[{number}]", "options": f'{{"gain":{number}}}'}.get(field, number)
    payload = whole.replace('"HERE"', put).encode()
    if message == "state":
        return decode_state(payload)
    if message == "header":
        return decode_header(payload)
    request = decode_request(payload)
    assert isinstance(request, Assign)
    return request


@pytest.mark.parametrize(("place", "largest"), INTEGERS.items())
def test_an_integer_is_taken_up_to_its_limit_and_fits_sqlite_and_javascript(
    place: tuple[str, str], largest: int
) -> None:
    decoded(*place, str(largest))
    assert int(float(largest)) == largest <= LARGEST_INTEGER < 2**53
    with closing(sqlite3.connect(":memory:")) as database:
        assert database.execute("SELECT ?", (largest,)).fetchone() == (largest,)
    for outside in (*OUTSIDE, str(largest + 1), "0.5", '"1"'):
        with pytest.raises(MessageError, match=place[1]):
            decoded(*place, outside)


@pytest.mark.parametrize(("place", "largest"), FLOATS.items())
def test_a_float_is_taken_up_to_its_limit_and_many_of_them_have_a_sum(place: tuple[str, str], largest: float) -> None:
    decoded(*place, repr(largest))
    signed = place[1] in ("x", "options")
    assert sum([largest] * 10**6) < 1e308
    assert largest**2 < 1e308
    taken = {"-1", str(2**63), str(-(2**63)), str(2**70)} if signed else set()
    for outside in {*OUTSIDE, repr(largest * 1.1)} - taken:
        with pytest.raises(MessageError, match=place[1]):
            decoded(*place, outside)


@pytest.mark.parametrize("name", ["maximum.01.true.0", "maximum.1.true.00", "maximum.1234567890.true.0", "m.0.true.-1"])
def test_a_rollout_has_one_name(name: str) -> None:
    with pytest.raises(MessageError, match="rollout"):
        decode_header(json.dumps(HEADER | {"rollout": name}).encode())


def test_every_number_of_every_message_has_a_range() -> None:
    """Also of a message that is added later."""
    for model in (WorkerState, ResultHeader, Assign, Ack, RolloutRequest):
        schema = model.model_json_schema()
        for name, part in schema["properties"].items():
            for each in [part, *part.get("anyOf", ()), *([part["items"]] if "items" in part else ())]:
                if each.get("type") in ("integer", "number"):
                    assert {"minimum", "exclusiveMinimum"} & set(each), (model, name)
                    assert {"maximum", "exclusiveMaximum"} & set(each), (model, name)


@pytest.mark.parametrize("step", [0, 7, -1, 2**53, 2**63, 2.5, float("nan"), float("inf")])
def test_progress_of_a_system_always_makes_a_heartbeat(step: float) -> None:
    state = WorkerState.model_validate(STATE | {"progress": within_steps(step)})
    assert decode_state(encode_message(state)) == state
