"""Several rollouts in one file for a viewer: every number of each, on a topic of its own, in the order of time."""

import io

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, SeekingReader
from mcap_protobuf.decoder import DecoderFactory

from perfbound.schemas.ids import RolloutId
from perfbound.schemas.trajectory.topics import encode_topics
from perfbound.schemas.trajectory.trajectory import Trajectory

UNITS = {"t": "s", "distance": "m", "topic": ""}
COLUMNS = tuple(UNITS)
ROLLOUTS = {
    RolloutId("robustness", 12, "true", 0): Trajectory(COLUMNS, np.array([[0.0, 1 / 3, 0.0], [0.1, -1e200, 2.0]])),
    RolloutId("robustness", 12, "true", 1): Trajectory(COLUMNS, np.array([[0.05, 1.0, 7.0]])),
    # A jump has two rows of one time.
    RolloutId("recheck", 0, "nominal", 10): Trajectory(
        COLUMNS, np.array([[0.0, 1.0, 1.0], [0.1, 1.0, 1.0], [0.1, 5.0, 1.0]])
    ),
}
TOPICS = ["/robustness/12/true/0", "/robustness/12/true/1", "/recheck/0/nominal/10"]


def encoded() -> bytes:
    return encode_topics(ROLLOUTS, units=UNITS, metadata={"campaign": "c", "robustness.12.true.0": "the worst"})


@pytest.mark.parametrize("kind", [SeekingReader, NonSeekingReader])
def test_each_rollout_is_a_topic_with_all_its_numbers(kind: type[SeekingReader] | type[NonSeekingReader]) -> None:
    found: dict[str, list[list[float]]] = {}
    times = []
    reader = kind(io.BytesIO(encoded()), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for schema, channel, message, body in reader.iter_decoded_messages():
        assert schema is not None
        assert (schema.name, schema.encoding, channel.message_encoding) == ("perfbound.State", "protobuf", "protobuf")
        assert channel.metadata == UNITS
        assert message.log_time == message.publish_time == round(body.t * 1e9)
        times.append(message.log_time)
        found.setdefault(channel.topic, []).append([getattr(body, name) for name in COLUMNS])
    assert times == sorted(times)
    assert found == {topic: each.samples.tolist() for topic, each in zip(TOPICS, ROLLOUTS.values(), strict=True)}, (
        "64 bits, which no float32 would keep"
    )


def test_the_summary_lists_topics_and_what_each_rollout_is() -> None:
    reader = SeekingReader(io.BytesIO(encoded()), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert [each.topic for each in summary.channels.values()] == TOPICS
    assert len(summary.schemas) == 1
    assert summary.statistics.channel_message_counts == {1: 2, 2: 1, 3: 3}
    (record,) = reader.iter_metadata()
    assert (record.name, record.metadata) == ("rollouts", {"campaign": "c", "robustness.12.true.0": "the worst"})
    assert list(reader.iter_attachments()) == []


def test_long_trajectories_take_several_chunks() -> None:
    t = np.arange(9000) / 100
    long = {each: Trajectory(COLUMNS, np.column_stack((t, np.sin(t), t))) for each in ROLLOUTS}
    reader = SeekingReader(io.BytesIO(encode_topics(long, units=UNITS, metadata={})), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 1
    assert sum(1 for _ in reader.iter_messages(topics=TOPICS[:1])) == len(t)
