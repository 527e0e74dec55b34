"""The rule of the interval of heartbeats, its message, and peers of a build without either."""

from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, TypeAdapter, ValidationError

from perfbound.schemas.errors import MessageError
from perfbound.schemas.link import messages
from perfbound.schemas.link.ends import OrchestratorEnd
from perfbound.schemas.link.messages import (
    HEARTBEAT,
    MOST,
    Ack,
    HeartbeatInterval,
    decode_request,
    encode_message,
    heartbeat_interval,
    is_near,
)
from tests.unit.schemas.link.test_ends import ACK, RUN, SECRET, a_state, joined

fleets = st.integers(0, 10_000)
limits = st.floats(1.0, 1e6)


@given(fleets, limits)
def test_two_heartbeats_in_a_row_may_be_lost_in_any_fleet(workers: int, hung_after: float) -> None:
    interval = heartbeat_interval(workers, hung_after)
    assert interval >= HEARTBEAT
    assert interval <= max(HEARTBEAT, hung_after / 3)


@given(fleets, limits)
def test_a_fleet_sends_no_more_than_the_rate_where_its_limits_allow_that(workers: int, hung_after: float) -> None:
    interval = heartbeat_interval(workers, hung_after)
    assert workers / interval <= MOST or 2 * interval > hung_after / 3
    assert interval == HEARTBEAT or workers / (interval / 2) > MOST, "and no longer one than that takes"


@given(st.integers(0, int(MOST * HEARTBEAT)), limits)
def test_a_small_fleet_has_the_interval_of_before(workers: int, hung_after: float) -> None:
    assert heartbeat_interval(workers, hung_after) == HEARTBEAT


def test_a_worker_that_comes_and_goes_changes_no_interval_of_the_others() -> None:
    at_limit = int(MOST * HEARTBEAT)
    more, fewer = (heartbeat_interval(workers, 60.0) for workers in (at_limit + 1, at_limit))
    assert (more, fewer) == (2 * HEARTBEAT, HEARTBEAT)
    assert not is_near(fewer, wanted=more)
    assert is_near(more, wanted=fewer)
    assert not is_near(4 * HEARTBEAT, wanted=fewer), "a fleet that has become small"


def test_an_interval_arrives_as_it_was_sent() -> None:
    message = HeartbeatInterval(seconds=4.0)
    assert encode_message(message) == b'{"type":"heartbeat_interval","seconds":4.0}'
    assert decode_request(encode_message(message)) == message


@pytest.mark.parametrize("seconds", ["0", "-1", "1e9", "null", '"4"'])
def test_an_interval_that_would_silence_a_worker_is_refused(seconds: str) -> None:
    with pytest.raises(MessageError, match=r"heartbeat_interval\.seconds"):
        decode_request(b'{"type":"heartbeat_interval","seconds":%s}' % seconds.encode())


def test_a_worker_of_before_drops_an_interval_and_takes_what_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    """It knows six requests; what it cannot read it ignores, as `_pass_request` of the transport does."""
    before = messages.Assign | messages.Cancel | Ack | messages.Refuse | messages.Release | messages.RunFinished
    known: TypeAdapter[object] = TypeAdapter(Annotated[before, Field(discriminator="type")])
    with pytest.raises(ValidationError, match="heartbeat_interval"):
        known.validate_json(encode_message(HeartbeatInterval(seconds=4.0)))
    monkeypatch.setattr(messages, "_REQUEST", known)
    orchestrator = OrchestratorEnd(SECRET, RUN)
    worker = joined(orchestrator)
    interval, ack = (orchestrator.request("w", each) for each in (HeartbeatInterval(seconds=4.0), ACK))
    with pytest.raises(MessageError):
        worker.request(interval.payload, interval.attachment)
    assert worker.request(ack.payload, ack.attachment) == ACK


def test_a_heartbeat_has_the_fields_that_an_orchestrator_of_before_knows() -> None:
    known = {"protocol", "version", "worker", "host", "pid", "systems", "parts", "state", "progress", "platform"}
    assert a_state().model_dump(exclude_none=True).keys() == known
