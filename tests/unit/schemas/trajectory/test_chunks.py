"""The file with a visual part has the bytes that the writer of mcap gives."""

import io
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from perfbound.schemas.base import canonical_json
from perfbound.schemas.trajectory import chunks
from perfbound.schemas.trajectory.canonical import EVIDENCE, LIBRARY, MAGIC, OF_ROLLOUT, RECORD, REQUEST
from perfbound.schemas.trajectory.channels import channels
from perfbound.schemas.trajectory.npy import to_npy
from perfbound.schemas.trajectory.trajectory import Trajectory, Transform, Visual, encode

REQUEST_OF: dict[str, Any] = {"seed": 7, "x": [1.0, 2.0]}
METADATA = {"seed": "7", "campaign": "c"}
NUMBERS = st.sampled_from([0.0, -0.0, 1.0, -2.5, 1e-300, 1e300]) | st.floats(-1e6, 1e6)


def written(trajectory: Trajectory, units: Mapping[str, str], chunk_bytes: int) -> bytes:
    """Return the file as the writer of mcap gives it, one message after the other."""
    assert trajectory.visual is not None
    out = io.BytesIO()
    writer = Writer(out, chunk_size=chunk_bytes, enable_data_crcs=True)
    writer.start(profile="", library=LIBRARY)
    writer.add_metadata(RECORD, dict(sorted({**METADATA, "columns": json.dumps(trajectory.columns)}.items())))
    attachments = {REQUEST: canonical_json(REQUEST_OF).encode(), EVIDENCE: to_npy(trajectory.samples)}
    for name, media_type in OF_ROLLOUT.media_types:
        writer.add_attachment(0, 0, name, media_type, attachments[name])
    kinds: dict[str, int] = {}
    messages = []
    for each in channels(trajectory.visual, trajectory.samples[trajectory.frames], units):
        name = each.kind.full_name
        kinds[name] = kinds.get(name) or writer.register_schema(name, "protobuf", each.definition)
        channel = writer.register_channel(each.topic, "protobuf", kinds[name], dict(each.metadata))
        messages += [(time, channel, data) for time, data in each.messages]
    for time, channel, data in sorted(messages, key=lambda message: message[:2]):
        writer.add_message(channel, time, data, time)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Trajectories with a scene or without, with frames that move, and with lines of a log in any order."""
    samples, columns = draw(st.integers(1, 90)), draw(st.integers(1, 20))
    times = np.cumsum(draw(st.lists(st.floats(0.001, 0.3), min_size=samples, max_size=samples))) - 0.001
    values = np.array(draw(st.lists(NUMBERS, min_size=columns, max_size=columns))) * np.ones((samples, 1))
    plain = Trajectory(("t", *(f"c{k}" for k in range(columns))), np.column_stack((times, values)))
    log = draw(st.lists(st.tuples(st.floats(0.0, 20.0), st.text(max_size=20)), max_size=4))
    names = draw(st.lists(st.sampled_from(["", "world", "a" * 150, "Rücken"]), max_size=3))
    transforms = tuple(_moving(draw, name, len(plain.frames)) for name in names)
    return plain.showing(Visual(draw(st.none() | st.builds(_scene, st.integers(0, 3))), transforms, tuple(log)))


def _moving(draw: st.DrawFn, name: str, frames: int) -> Transform:
    numbers = np.array(draw(st.lists(NUMBERS, min_size=7, max_size=7))) * np.ones((frames, 1))
    numbers[draw(st.integers(0, frames - 1)), draw(st.integers(0, 6))] = draw(NUMBERS)
    return Transform(name, f"of {name}", numbers[:, :3], numbers[:, 3:])


def _scene(solids: int) -> SceneUpdate:
    cubes = [CubePrimitive(size=Vector3(x=each, y=1, z=1)) for each in range(solids)]
    return SceneUpdate(entities=[SceneEntity(id="body", cubes=cubes, spheres=[SpherePrimitive()])])


@given(trajectories(), st.sampled_from([1, 700, 5000, chunks.CHUNK_BYTES]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)
def test_the_file_is_the_one_of_mcap(monkeypatch: pytest.MonkeyPatch, trajectory: Trajectory, size: int) -> None:
    monkeypatch.setattr(chunks, "CHUNK_BYTES", size)
    units = dict.fromkeys(trajectory.columns, "m")
    assert encode(trajectory, request=REQUEST_OF, metadata=METADATA, units=units) == written(trajectory, units, size)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_every_record_of_a_file_with_plots_is_the_one_of_mcap(count: int) -> None:
    """Of another compression than the writer of mcap has, and without the places of the groups in the summary."""
    samples = np.arange(200.0 * (count + 1)).reshape(200, -1)
    trajectory = Trajectory(("t", *(f"c{k}" for k in range(count))), samples).showing(Visual(plots=True))
    units = dict.fromkeys(trajectory.columns, "m")
    data = encode(trajectory, request=REQUEST_OF, metadata=METADATA, units=units)
    out = RecordBuilder()
    out.write(MAGIC)
    kinds = set()
    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        kinds.add(type(record).__name__)
        record.write(out)
    out.write(MAGIC)
    assert out.end() == data  # type: ignore[no-untyped-call]
    assert kinds >= {"Chunk", "MessageIndex", "Schema", "Channel", "Statistics", "ChunkIndex"}
