"""Texts from outside: one line of a bounded length, wherever they enter."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.errors import LONGEST_EXCERPT, MessageError, shortened
from perfbound.schemas.failure import Failure
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.messages import MAX_MESSAGE, Refuse, decode_header, decode_state, encode_message
from tests.unit.schemas.test_ranges import HEADER, STATE

HOSTILE = "\x1b[2J\r\n\u202e" + "x" * 40_000


@given(text=st.text(alphabet=st.characters(codec=None), max_size=1000), longest=st.integers(20, 400))
def test_an_excerpt_is_short_one_line_and_its_own_excerpt(text: str, longest: int) -> None:
    found = shortened(text, longest)
    assert len(found) <= longest
    assert found.isprintable()
    assert shortened(found, longest) == found
    if len(text) <= longest and text.isprintable():
        assert found == text


def test_the_end_of_a_long_text_is_kept() -> None:
    assert shortened("RuntimeError: " + "x" * 9999 + " (cars.py, line 17)").startswith("RuntimeError: xx")
    assert shortened("RuntimeError: " + "x" * 9999 + " (cars.py, line 17)").endswith("x (cars.py, line 17)")


def test_a_reason_is_cut_where_it_enters() -> None:
    header = decode_header(json.dumps(HEADER | {"outcome": "failed", "sha256": "", "error": HOSTILE}).encode())
    assert len(header.error) == LONGEST_EXCERPT
    assert header.error.isprintable()
    assert header.error.startswith("\\x1b[2J\\r\\n\\u202exxx")
    assert decode_header(encode_message(header)) == header
    assert Failure("system", HOSTILE).reason == header.error


def test_the_words_of_a_heartbeat_are_one_line() -> None:
    state = decode_state(json.dumps(STATE | {"host": "\x1b[2J\nhost"}).encode())
    assert state.host == "\\x1b[2J\\nhost"
    with pytest.raises(MessageError, match="host"):
        decode_state(json.dumps(STATE | {"host": "h" * 201}).encode())


def test_a_fault_of_a_message_does_not_repeat_the_message() -> None:
    for message in (STATE | {HOSTILE: 1}, STATE | {"systems": {HOSTILE: "d" * 64}}, STATE | {"host": [HOSTILE]}):
        payload = json.dumps(message).encode()
        assert len(payload) < MAX_MESSAGE
        with pytest.raises(MessageError) as found:
            decode_state(payload)
        assert len(str(found.value)) <= LONGEST_EXCERPT
        assert str(found.value).isprintable()


def test_a_refusal_of_any_length_can_be_sent() -> None:
    """A system of many files makes a long one."""
    assert len(Refuse(reason="the worker's system differs: " + "x" * 90_000).reason) == 2000


@pytest.mark.parametrize("name", ["", "a b", "\x1b[2J", "x" * 101, "-a", "ü", "*"])
def test_a_name_of_a_worker_is_a_word(name: str) -> None:
    for key in (
        key_expressions.live_worker("r", name),
        key_expressions.state_key("r", name),
        key_expressions.result_key("r", name, "m.0.true.0", 1),
    ):
        with pytest.raises(MessageError, match="no name of a worker"):
            key_expressions.worker_of(key)
        assert len(key_expressions.sender_of(key)) <= 100
        assert key_expressions.sender_of(key).isprintable()


def test_the_longest_name_with_its_suffix_is_one() -> None:
    name = key_expressions.fresh_id("n" * 64)
    assert (
        key_expressions.worker_of(key_expressions.state_key("r", name))
        == key_expressions.worker_of(key_expressions.live_worker("r", name))
        == name
    )
