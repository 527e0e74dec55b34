"""Trajectory files whose columns are plots: the same numbers at the same times, with an index and without."""

import io
import struct
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Chunk, Message, MessageIndex

from perfbound.schemas.errors import TrajectoryError
from perfbound.schemas.trajectory import plots
from perfbound.schemas.trajectory.trajectory import Trajectory, Visual, decode, encode

REQUEST: dict[str, Any] = {"seed": 7, "x": [1.0, 2.0]}
UNITS = {"t": "s", "distance": "m", "share": ""}


def a_trajectory(samples: int = 31, step: float = 0.05) -> Trajectory:
    t = step * np.arange(samples)
    return Trajectory(tuple(UNITS), np.column_stack([t, np.sin(t), -t]))


def file_of(trajectory: Trajectory, *, plotted: bool = True) -> bytes:
    shown = trajectory.showing(Visual(plots=True)) if plotted else trajectory
    units = {name: UNITS.get(name, "m") for name in trajectory.columns}
    return encode(shown, request=REQUEST, metadata={"campaign": "c"}, units=units)


def numbers(data: bytes, reader: type[SeekingReader] | type[NonSeekingReader]) -> dict[str, list[tuple[int, float]]]:
    """Return (nanoseconds, number) of every message, by topic."""
    found: dict[str, list[tuple[int, float]]] = {}
    for schema, channel, message in reader(io.BytesIO(data), validate_crcs=True).iter_messages():
        assert schema is not None
        assert (schema.name, schema.encoding, channel.message_encoding) == (plots.MESSAGE, "ros2msg", "cdr")
        assert message.log_time == message.publish_time
        start, dimensions, offset, length, number = struct.unpack("<4s3I4xd", message.data)
        assert (start, dimensions, offset, length) == (b"\0\1\0\0", 0, 0, 1)
        found.setdefault(channel.topic, []).append((message.log_time, number))
    return found


@pytest.mark.parametrize("reader", [SeekingReader, NonSeekingReader])
def test_every_column_but_the_time_is_a_channel_of_its_numbers(reader: Any) -> None:
    trajectory = a_trajectory()
    times = [50_000_000 * k for k in range(31)]
    found = numbers(file_of(trajectory), reader)
    assert found == {
        f"/{name}": list(zip(times, trajectory.column(name).tolist(), strict=True)) for name in ("distance", "share")
    }


def test_the_summary_lists_channels_with_units_and_the_evidence() -> None:
    summary = SeekingReader(io.BytesIO(file_of(a_trajectory())), validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert {each.topic: each.metadata for each in summary.channels.values()} == {
        "/distance": {"unit": "m"},
        "/share": {"unit": ""},
    }
    assert summary.statistics.channel_message_counts == {1: 31, 2: 31}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 1_500_000_000)
    assert [each.name for each in summary.attachment_indexes] == ["request.json", "trajectory.npy"]
    assert [each.name for each in summary.metadata_indexes] == ["rollout"]


def test_the_indexes_lead_to_the_messages_of_their_channel() -> None:
    """As Foxglove reads; the reader of Python goes through the whole chunk."""
    data = file_of(a_trajectory())
    summary = SeekingReader(io.BytesIO(data)).get_summary()
    assert summary is not None
    (found,) = summary.chunk_indexes
    stream = ReadDataStream(io.BytesIO(data[found.chunk_start_offset + 9 :]))
    content = zstandard.decompress(Chunk.read(stream).data)
    assert found.chunk_length == stream.count + 9
    assert sorted(found.message_index_offsets) == [1, 2]
    for channel, place in found.message_index_offsets.items():
        index = MessageIndex.read(ReadDataStream(io.BytesIO(data[place + 9 :])))
        assert data[place] == Opcode.MESSAGE_INDEX
        assert (index.channel_id, len(index.records)) == (channel, 31)
        for time, offset in index.records:
            assert content[offset] == Opcode.MESSAGE
            length = int.from_bytes(content[offset + 1 : offset + 9], "little")
            message = Message.read(ReadDataStream(io.BytesIO(content[offset + 9 :])), length)
            assert (message.channel_id, message.log_time) == (channel, time)


def test_plots_change_nothing_of_the_evidence() -> None:
    plain, plotted = file_of(a_trajectory(), plotted=False), file_of(a_trajectory())
    assert decode(plotted).samples.tobytes() == decode(plain).samples.tobytes()
    assert numbers(plain, NonSeekingReader) == {}
    assert file_of(a_trajectory()) == plotted, "equal arguments give equal bytes"


def test_every_byte_is_covered_by_a_checksum() -> None:
    data = file_of(a_trajectory(3))
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1
        with pytest.raises(TrajectoryError):
            decode(bytes(damaged))


@pytest.mark.parametrize(("samples", "stride"), [(10_000, 1), (10_001, 2), (30_000, 3), (1, 1)])
def test_of_a_long_trajectory_every_second_or_third_sample_is_shown(samples: int, stride: int) -> None:
    trajectory = a_trajectory(samples)
    shown = numbers(file_of(trajectory), SeekingReader)
    assert [number for _, number in shown["/distance"]] == trajectory.column("distance")[::stride].tolist()


def test_of_very_many_columns_the_first_ones_are_shown() -> None:
    names = ("t", *(f"c{k}" for k in range(1500)))
    data = file_of(Trajectory(names, np.arange(3 * 1501.0).reshape(3, -1)))
    found, summary = numbers(data, SeekingReader), SeekingReader(io.BytesIO(data)).get_summary()
    assert summary is not None
    assert len(summary.channels) == 1000
    assert sorted(found) == sorted(f"/{name}" for name in names[1:1001])
    assert found["/c999"] == [(0, 1000.0), (1501 * 10**9, 2501.0), (3002 * 10**9, 4002.0)]


def test_times_that_no_viewer_has_do_no_harm() -> None:
    found = numbers(file_of(Trajectory(("t", "x"), np.array([[0.0, 1.0], [1e300, 2.0]]))), SeekingReader)
    assert found["/x"] == [(0, 1.0), (9 * 10**18, 2.0)]


def test_plots_and_a_scene_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="either plots, or a scene"):
        Visual(log=((0.0, "start"),), plots=True)
