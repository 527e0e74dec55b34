import io
import math
import struct
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from perfbound.schemas.errors import TrajectoryError
from perfbound.schemas.trajectory import file_checks
from perfbound.schemas.trajectory import trajectory as module
from perfbound.schemas.trajectory.trajectory import Trajectory, Transform, Visual, decode, encode
from tests.facts import facts

UNITS = {"t": "s", "x": "m", "phi": "rad"}
REQUEST: dict[str, Any] = {"seed": 7, "x": [1.0, 2.0]}
METADATA = {"campaign": "c", "seed": "7"}


def a_trajectory(samples: int = 241, *, visual: bool = False) -> Trajectory:
    t = np.arange(samples) / 120
    plain = Trajectory(tuple(UNITS), np.column_stack([t, np.sin(t) / 3, -t]))
    return replace(plain, visual=a_visual(len(plain.frames))) if visual else plain


def a_visual(frames: int) -> Visual:
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (frames, 1))
    body = Transform('the "world" 100%', "body", np.full((frames, 3), 1 / 3), turn)
    arm = Transform("body", "arm", np.full((frames, 3), 1e-9), turn)
    return Visual(a_scene(), (body, arm), ((0.0, "start"), (1.5, "fallen")))


def a_scene() -> SceneUpdate:
    """A red wheel: a cylinder whose axis is turned from z to y."""
    pose = Pose(position=Vector3(x=1, y=2, z=3), orientation=Quaternion(x=0.5**0.5, w=0.5**0.5))
    wheel = CylinderPrimitive(pose=pose, size=Vector3(x=0.4, y=0.4, z=0.1), color=Color(r=1, a=0.5))
    return SceneUpdate(entities=[SceneEntity(id="wheels", frame_id="body", cylinders=[wheel])])


def encoded(trajectory: Trajectory) -> bytes:
    return encode(trajectory, request=REQUEST, metadata=METADATA, units=UNITS)


# The value


def test_samples_are_a_read_only_copy() -> None:
    mine = np.asfortranarray([[0.0, 1.0], [0.1, 2.0]])
    trajectory = Trajectory(("t", "x"), mine)
    mine[0, 1] = 9
    assert trajectory.samples.flags.c_contiguous
    assert trajectory.column("x").tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        trajectory.samples[0, 0] = 1
    with pytest.raises(KeyError):
        trajectory.column("y")


@pytest.mark.parametrize(
    ("columns", "samples"),
    [
        (("x", "t"), [[0.0, 1.0]]),
        (("t",), [[0.0]]),
        (("t", "x", "x"), [[0.0, 1.0, 1.0]]),
        (("t", "x"), [[0.0, 1.0, 1.0]]),
        (("t", "x"), np.empty((0, 2))),
        (("t", "x"), [0.0, 1.0]),
        (("t", "x"), [[0.0, np.nan]]),
        (("t", "x"), [[0.0, 1.0], [np.inf, 1.0]]),
        (("t", "x"), [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]]),
        (("t", "x"), [[0.0, 1.0], [0.2, 1.0], [0.1, 1.0]]),
        (("t", "x"), [[-1.0, 1.0], [0.0, 1.0]]),
    ],
)
def test_what_is_no_trajectory_is_refused(columns: tuple[str, ...], samples: Any) -> None:
    with pytest.raises(ValueError, match=r"columns|samples|time|state"):
        Trajectory(columns, np.asarray(samples))


def test_a_number_that_is_not_finite_is_named_with_its_column_and_time() -> None:
    samples = np.column_stack([np.arange(4) * 0.5, np.zeros(4), [0.0, 1.0, np.nan, np.nan]])
    with pytest.raises(ValueError, match=facts("finite: nan t = 1 s 2 fix")):
        Trajectory(("t", "angle", "rate"), samples)


def test_frames_are_thirty_a_second() -> None:
    trajectory = a_trajectory(1801)
    assert len(trajectory.frames) == 451
    assert trajectory.frames[:3].tolist() == [0, 4, 8]
    assert a_trajectory(1).frames.tolist() == [0]


def test_a_visual_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="frames"):
        replace(a_trajectory(), visual=a_visual(3))


def test_a_transform_is_finite_and_has_the_right_shape() -> None:
    with pytest.raises(ValueError, match="shapes"):
        Transform("a", "b", np.zeros((2, 3)), np.zeros((3, 4)))
    with pytest.raises(ValueError, match="finite"):
        Transform("a", "b", np.zeros((2, 3)), np.full((2, 4), np.nan))


# The file


@pytest.mark.rest
@given(
    columns=st.lists(st.text(min_size=1), min_size=1, max_size=5, unique=True).filter(lambda names: "t" not in names),
    data=st.data(),
)
def test_round_trip_is_exact(columns: list[str], data: st.DataObject) -> None:
    rows = data.draw(st.integers(1, 20))
    numbers = st.floats(allow_nan=False, allow_infinity=False)
    values = np.array([[data.draw(numbers) for _ in columns] for _ in range(rows)])
    trajectory = Trajectory(("t", *columns), np.column_stack([np.arange(rows) / 120, values]))
    again = decode(encode(trajectory, request={}, metadata={}, units=dict.fromkeys(trajectory.columns, "1")))
    assert again.columns == trajectory.columns
    assert again.samples.tobytes() == trajectory.samples.tobytes()
    assert not again.samples.flags.writeable


@pytest.mark.parametrize("visual", [False, True])
def test_equal_input_gives_equal_bytes(visual: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    first = encoded(a_trajectory(visual=visual))
    monkeypatch.setattr(time, "time", lambda: 1e9)
    assert encoded(a_trajectory(visual=visual)) == first
    shuffled = dict(reversed(METADATA.items()))
    assert encode(a_trajectory(visual=visual), request=REQUEST, metadata=shuffled, units=UNITS) == first


def test_the_conventions_of_the_file() -> None:
    reader = make_reader(io.BytesIO(encoded(a_trajectory())), validate_crcs=True)
    header = reader.get_header()
    assert (header.profile, header.library) == ("", "perfbound")
    attachments = {item.name: item.data for item in reader.iter_attachments()}
    assert attachments["request.json"] == b'{"seed":7,"x":[1.0,2.0]}'
    array = np.load(io.BytesIO(attachments["trajectory.npy"]), allow_pickle=False)
    assert array.dtype == np.float64
    assert array.shape == (241, 3)
    (record,) = reader.iter_metadata()
    assert record.metadata == {"campaign": "c", "columns": '["t", "x", "phi"]', "seed": "7"}
    assert list(reader.iter_messages()) == []


def seen_in(data: bytes) -> dict[str, list[Any]]:
    """Return the times and messages of every topic, decoded by the types that the file holds."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    seen: dict[str, list[Any]] = {}
    for _, channel, message, body in reader.iter_decoded_messages():
        assert message.log_time == message.publish_time
        seen.setdefault(channel.topic, []).append((message.log_time, body))
    return seen


def test_a_person_sees_valid_messages_at_thirty_hertz() -> None:
    seen = seen_in(encoded(a_trajectory(visual=True)))
    assert {topic: len(messages) for topic, messages in seen.items()} == {
        "/tf": 61,
        "/state": 61,
        "/scene": 1,
        "/solids/wheels/0": 1,
        "/log": 2,
    }
    when, frame = seen["/tf"][31]
    body, arm = frame.transforms
    assert (body.timestamp.seconds, body.timestamp.nanos) == (1, when - 10**9)
    assert (body.parent_frame_id, arm.parent_frame_id) == ('the "world" 100%', "body")
    assert (body.translation.x, arm.translation.x) == (1 / 3, 1e-9)
    assert [getattr(body.rotation, name) for name in "xyzw"] == [0, 0, 0, 1]
    when, state = seen["/state"][31]
    assert state.DESCRIPTOR.full_name == "perfbound.State"
    assert [state.t, state.x, state.phi] == pytest.approx([when / 1e9, math.sin(when / 1e9) / 3, -when / 1e9])
    assert [field.name for field in state.DESCRIPTOR.fields] == list(UNITS)
    assert [(when, line.message, line.level) for when, line in seen["/log"]] == [
        (0, "start", 2),
        (15 * 10**8, "fallen", 2),
    ]


def test_a_type_comes_after_what_it_imports() -> None:
    """Readers take in the files of a definition one by one."""
    summary = make_reader(io.BytesIO(encoded(a_trajectory(visual=True)))).get_summary()
    assert summary is not None
    schemas = list(summary.schemas.values())
    assert len({schema.name for schema in schemas}) == len(schemas) == 5
    for schema in schemas:
        files = FileDescriptorSet.FromString(schema.data).file
        names = [file.name for file in files]
        assert len(set(names)) == len(names)
        for number, file in enumerate(files):
            assert set(file.dependency) <= set(names[:number])
        assert schema.name.rpartition(".")[2] in {message.name for message in files[-1].message_type}


def test_the_units_stand_beside_the_state() -> None:
    summary = make_reader(io.BytesIO(encoded(a_trajectory(visual=True)))).get_summary()
    assert summary is not None
    assert {channel.topic: channel.metadata for channel in summary.channels.values() if channel.metadata} == {
        "/state": UNITS
    }


def test_a_solid_is_also_a_grid_of_one_cell() -> None:
    """Its corner is the lowest one of the box, turned with it: -0.2, -0.2, -0.05 becomes -0.2, 0.05, -0.2."""
    ((_, grid),) = seen_in(encoded(a_trajectory(visual=True)))["/solids/wheels/0"]
    (wheel,) = a_scene().entities[0].cylinders
    corner = [getattr(grid.pose.position, name) for name in "xyz"]
    assert corner == pytest.approx([1 - 0.2, 2 + 0.05, 3 - 0.2])
    assert grid.pose.orientation.w == wheel.pose.orientation.w
    assert [getattr(grid.cell_size, name) for name in "xyz"] == [0.4, 0.4, 0.1]
    assert (grid.frame_id, grid.row_count, grid.column_count) == ("body", 1, 1)
    assert grid.data == bytes([255, 0, 0, 128])
    assert [field.name for field in grid.fields] == ["red", "green", "blue", "alpha"]


@pytest.mark.parametrize("column", ["phi%", "", "1"])
def test_a_column_that_a_person_sees_is_a_field(column: str) -> None:
    plain = Trajectory(("t", column), np.array([[0.0, 1.0]]), Visual(SceneUpdate(), ()))
    with pytest.raises(ValueError, match="names of protobuf fields"):
        encode(plain, request={}, metadata={}, units={"t": "s", column: "1"})


def test_a_scene_may_stand_still() -> None:
    still = replace(a_trajectory(), visual=Visual(SceneUpdate(), ()))
    assert set(seen_in(encoded(still))) == {"/scene", "/state"}


def test_every_column_has_a_unit() -> None:
    with pytest.raises(ValueError, match="no unit for phi, x"):
        encode(a_trajectory(), request={}, metadata={}, units={"t": "s"})


def test_a_request_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        encode(a_trajectory(), request={"x": float("nan")}, metadata={}, units=UNITS)


# Damage


@pytest.mark.parametrize("visual", [False, True])
def test_every_flipped_bit_is_found(visual: bool) -> None:
    whole = encoded(a_trajectory(4, visual=visual))
    for position in range(len(whole)):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << position % 8
        with pytest.raises(TrajectoryError):
            decode(bytes(damaged))


def test_every_cut_is_found() -> None:
    whole = encoded(a_trajectory(4))
    for end in range(len(whole)):
        with pytest.raises(TrajectoryError):
            decode(whole[:end])
    with pytest.raises(TrajectoryError):
        decode(whole + b"\0")


@settings(max_examples=200)
@given(st.binary(max_size=300))
def test_noise_is_no_file(data: bytes) -> None:
    with pytest.raises(TrajectoryError):
        decode(data)


def a_file(*attachments: tuple[str, bytes], records: tuple[dict[str, str], ...] = ({"columns": '["t","x"]'},)) -> bytes:
    """A whole file with true checksums from a worker that does not keep to the rules."""
    out = io.BytesIO()
    writer = Writer(out, enable_data_crcs=True)
    writer.start()
    for record in records:
        writer.add_metadata("rollout", record)
    for name, data in attachments:
        writer.add_attachment(0, 0, name, "", data)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def npy(array: Any, *, version: tuple[int, int] = (1, 0)) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array), version=version, allow_pickle=True)
    return out.getvalue()


GOOD = npy([[0.0, 1.0]])
JSON = ("request.json", b"{}")


def test_a_foreign_file_that_keeps_to_the_rules_is_read() -> None:
    assert decode(a_file(("trajectory.npy", GOOD), JSON)).samples.tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize(
    "array",
    [
        npy([[0.0, np.nan]]),
        npy([[0, 1]]),
        npy([0.0, 1.0]),
        npy([[0.0, 1.0, 2.0]]),
        npy([[1.0, 1.0], [0.0, 1.0]]),
        npy(np.asfortranarray([[0.0, 1.0], [1.0, 1.0]])),
        npy(np.array([[None, 1]], dtype=object)),
        npy([[0.0, 1.0]], version=(2, 0)),
        npy(np.empty((0, 2))),
        GOOD[:-1],
        GOOD + b"\0",
        GOOD.replace(b"(1, 2)", b"(9, 9)"),
        GOOD.replace(b"(1, 2)", b"(-1,-2)").replace(b"}  ", b"} ", 1),
        GOOD.replace(b"'<f8'", b"'<f8"),
        b"",
    ],
)
def test_a_bad_array_is_refused(array: bytes) -> None:
    with pytest.raises(TrajectoryError):
        decode(a_file(("trajectory.npy", array), JSON))


@pytest.mark.parametrize(
    "records",
    [
        (),
        ({},),
        ({"columns": '["t","x"]'},) * 2,
        ({"columns": "t,x"},),
        ({"columns": '{"t":1,"x":2}'},),
        ({"columns": "[1,2]"},),
        ({"columns": '["x","t"]'},),
        ({"columns": '["t","x","y"]'},),
        ({"columns": "[" * 100_000},),
    ],
)
def test_bad_metadata_is_refused(records: tuple[dict[str, str], ...]) -> None:
    with pytest.raises(TrajectoryError):
        decode(a_file(("trajectory.npy", GOOD), JSON, records=records))


@pytest.mark.parametrize("attachments", [(), (JSON,), (("trajectory.npy", GOOD),), (JSON, ("trajectory.npz", GOOD))])
def test_a_missing_attachment_is_named(attachments: tuple[tuple[str, bytes], ...]) -> None:
    with pytest.raises(TrajectoryError, match="the attachments"):
        decode(a_file(*attachments))


def test_two_arrays_are_refused() -> None:
    with pytest.raises(TrajectoryError, match="the attachments"):
        decode(a_file(("trajectory.npy", GOOD), ("trajectory.npy", GOOD), JSON))


def test_what_is_decoded_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_checks, "MAX_RECORDS", 3)
    with pytest.raises(TrajectoryError, match="records"):
        decode(encoded(a_trajectory()))
    monkeypatch.setattr(file_checks, "MAX_FILE_BYTES", 1000)
    with pytest.raises(TrajectoryError, match="above 1000"):
        decode(encoded(a_trajectory()))


# The canonical file


PLAIN, PLOTS, SCENE = (
    encode(trajectory, request={"a": 1}, metadata={"b": "c"}, units=UNITS)
    for trajectory in (a_trajectory(4), a_trajectory(4).showing(Visual(plots=True)), a_trajectory(4, visual=True))
)


@pytest.mark.parametrize("whole", [PLAIN, PLOTS, SCENE], ids=["plain", "plots", "scene"])
def test_what_is_encoded_is_canonical(whole: bytes) -> None:
    assert module.read_canonical(whole, visual=True).request == {"a": 1}


@settings(max_examples=30)
@given(st.integers(1, 300), st.text(max_size=30), st.dictionaries(st.text(max_size=5), st.text(max_size=9), max_size=4))
def test_every_encoded_file_is_canonical(rows: int, text: str, metadata: dict[str, str]) -> None:
    request = {"text": text, "rows": rows}
    whole = encode(a_trajectory(rows), request=request, metadata=metadata, units=UNITS)
    assert module.read_canonical(whole, visual=False).request == request


def test_a_visual_part_that_nobody_requested_is_refused() -> None:
    for whole in (PLOTS, SCENE):
        with pytest.raises(TrajectoryError, match="no visual part was requested"):
            module.read_canonical(whole, visual=False)


def sealed(data: bytes, summary: bytes) -> bytes:
    """Return a file of other data and another summary, with true checksums."""
    data += struct.pack("<BQI", 0x0F, 4, zlib.crc32(data))
    end = summary + struct.pack("<BQQQ", 0x02, 20, len(data), 0)
    return data + end + struct.pack("<I", zlib.crc32(end)) + PLAIN[:8]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


@pytest.mark.parametrize("whole", [PLAIN, PLOTS, SCENE], ids=["plain", "plots", "scene"])
@pytest.mark.parametrize(
    "change",
    [
        lambda data, summary: (data + record(0x0C, b"\4\0\0\0more\0\0\0\0"), summary),  # metadata behind the evidence
        lambda data, summary: (data + record(0x80, b"anything"), summary),  # a record that readers skip
        lambda data, summary: (data, summary + record(0x80, b"anything")),
        lambda data, summary: (data, summary + record(0x0D, bytes(16) + b"\4\0\0\0more")),
        lambda data, summary: (data, summary.replace(b"request.json", b"request.jsom")),
        lambda data, summary: (data.replace(b"perfbound", b"perfbounb"), summary),
        lambda data, summary: (data.replace(b"x-npy", b"y-npy"), summary),
        lambda data, summary: (data, b""),
        lambda data, summary: (data, summary + b"\0" * 5),
    ],
)
def test_another_file_of_the_same_evidence_is_refused(whole: bytes, change: Any) -> None:
    footer = len(whole) - 8 - 29
    start = struct.unpack_from("<Q", whole, footer + 9)[0]
    changed = sealed(*change(whole[: start - 13], whole[start:footer]))
    with pytest.raises(TrajectoryError):
        module.read_canonical(changed, visual=True)


def test_the_fixtures_are_canonical() -> None:
    """Files of every version of perfbound so far."""
    found = sorted((Path(__file__).parents[3] / "fixtures").rglob("*.mcap"))
    assert len(found) > 100
    for path in found:
        module.read_canonical(path.read_bytes(), visual=False)
