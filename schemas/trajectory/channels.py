"""The channels of a visual part: protobuf messages of foxglove's types: /scene, /solids, /log, /tf and /state.

| symbol | meaning |
|---|---|
| F | frames of the visual part |
| n | columns of the trajectory |

Foxglove draws /scene. rerun draws VoxelGrids but no scenes, so that each solid of the scene is also a grid of one cell
on a topic of its own under /solids: a box, also for a cylinder or a sphere.
"""

import functools
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from foxglove_schemas_protobuf.VoxelGrid_pb2 import VoxelGrid
from google.protobuf.descriptor import Descriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from . import pack
from .visual import Floats, Transform, Visual

Messages = Iterator[tuple[int, bytes]]
"""Pairs of a time in nanoseconds and a message as bytes."""
Vector = tuple[float, ...]
Solid = CubePrimitive | CylinderPrimitive | SpherePrimitive


class Channel(NamedTuple):
    """One channel of a file: its topic, the type of its messages, the messages, and remarks by name."""

    topic: str
    kind: Descriptor
    messages: Messages
    metadata: Mapping[str, str] = {}

    @property
    def definition(self) -> bytes:
        """The type of the messages: a google.protobuf.FileDescriptorSet, every file after those that it imports."""
        return _definition(self.kind)


def channels(visual: Visual, rows: Floats, units: Mapping[str, str]) -> tuple[Channel, ...]:
    """Return the channels of a trajectory with the visible `rows`, shape (F, n).

    `units` contains the columns of `rows`, in their order, with their units; the first one is the time in s.

    Raises:
        ValueError: the name of a column is no name of a protobuf field.

    """
    scene = SceneUpdate() if visual.scene is None else visual.scene
    times = _nanoseconds(rows[:, 0])
    with np.errstate(over="ignore"):  # beyond float32 a number is infinite, as protobuf has it
        numbers = rows.astype(np.float32)
    return (
        Channel("/scene", SceneUpdate.DESCRIPTOR, _one_message(times[0], scene)),
        # Each solid once more, as a grid of one voxel: rerun draws no scene.
        *(Channel(topic, VoxelGrid.DESCRIPTOR, _one_message(times[0], grid)) for topic, grid in _solids(scene)),
        Channel("/log", Log.DESCRIPTOR, _log_messages(visual.log)),
        Channel("/tf", FrameTransforms.DESCRIPTOR, _transform_messages(times, visual.transforms)),
        # Half the size, and enough for a plot.
        state_channel("/state", rows[:, 0], numbers, units),
    )


def state_channel(topic: str, times: Floats, rows: Floats | NDArray[np.float32], units: Mapping[str, str]) -> Channel:
    """Return the channel whose messages have all columns of `rows` (F, n), with 32 or 64 bits as these have.

    `times` are in s; `units` is as in `channels`.
    """
    kind = FieldDescriptorProto.TYPE_FLOAT if rows.itemsize == 4 else FieldDescriptorProto.TYPE_DOUBLE
    messages = zip(_nanoseconds(times), pack.rows(pack.numbers(rows)), strict=True)
    return Channel(topic, _state(tuple(units), kind), messages, units)


def _nanoseconds(seconds: Floats) -> list[int]:
    times: list[int] = np.rint(seconds * 1e9).astype(np.int64).tolist()
    return times


def _bytes(message: Message) -> bytes:
    return message.SerializeToString(deterministic=True)


def _one_message(time: int, message: Message) -> Messages:
    yield time, _bytes(message)


def _log_messages(lines: tuple[tuple[float, str], ...]) -> Messages:
    for seconds, text in lines:
        time = round(seconds * 1e9)
        message = Log(level=Log.INFO, message=text, name="perfbound")
        message.timestamp.FromNanoseconds(time)
        yield time, _bytes(message)


def _transform_messages(times: list[int], transforms: tuple[Transform, ...]) -> Messages:
    if not transforms:
        return iter(())
    stamp = pack.message(1, pack.integers(1, np.array(times) // 10**9), pack.integers(2, np.array(times) % 10**9))
    found = [
        pack.message(
            1,
            stamp,
            pack.text(2, pose.parent, len(times)),
            pack.text(3, pose.child, len(times)),
            pack.message(4, pack.numbers(pose.translation)),
            pack.message(5, pack.numbers(pose.rotation)),
        )
        for pose in transforms
    ]
    return zip(times, pack.rows(*found), strict=True)


@functools.lru_cache
def _state(columns: tuple[str, ...], kind: FieldDescriptorProto.Type) -> Descriptor:
    """Return the type of messages with a number for each column."""
    file = FileDescriptorProto(name="perfbound/State.proto", package="perfbound", syntax="proto3")
    message = file.message_type.add(name="State")
    for number, name in enumerate(columns, start=1):
        message.field.add(
            name=name,
            number=number,
            type=kind,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
    try:
        found = DescriptorPool().AddSerializedFile(file.SerializeToString())
    except TypeError as error:
        raise ValueError(f"visible columns need names of protobuf fields: {columns}") from error
    return found.message_types_by_name["State"]


@functools.lru_cache
def _definition(kind: Descriptor) -> bytes:
    files = FileDescriptorSet(file=(FileDescriptorProto.FromString(each.serialized_pb) for each in _files(kind.file)))
    return _bytes(files)


def _files(file: Any) -> list[Any]:
    """Return a file after all that it imports, each once."""
    imported = (each for direct in file.dependencies for each in _files(direct))
    return list(dict.fromkeys([*imported, file]))


# The boxes that rerun draws

_RGBA = [
    PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
    for offset, name in enumerate(("red", "green", "blue", "alpha"))
]


def _solids(scene: SceneUpdate) -> Iterator[tuple[str, VoxelGrid]]:
    """Yield the topic and the box of every cube, cylinder and sphere."""
    for entity in scene.entities:
        solids: list[Solid] = [*entity.cubes, *entity.cylinders, *entity.spheres]
        for number, solid in enumerate(solids):
            yield f"/solids/{entity.id}/{number}", _box(entity.frame_id, solid)


def _box(frame: str, solid: Solid) -> VoxelGrid:
    """Return the box around a solid as a grid of one cell; the pose of a grid is that of its lowest corner."""
    centre, turn, size, color = solid.pose.position, solid.pose.orientation, solid.size, solid.color
    x, y, z = _turned((size.x / 2, size.y / 2, size.z / 2), turn)
    cell = bytes(round(255 * min(max(part, 0.0), 1.0)) for part in (color.r, color.g, color.b, color.a))
    return VoxelGrid(
        timestamp=Timestamp(),
        frame_id=frame,
        pose=Pose(position=Vector3(x=centre.x - x, y=centre.y - y, z=centre.z - z), orientation=turn),
        row_count=1,
        column_count=1,
        cell_size=size,
        slice_stride=len(cell),
        row_stride=len(cell),
        cell_stride=len(cell),
        fields=_RGBA,
        data=cell,
    )


def _turned(vector: Vector, turn: Quaternion) -> Vector:
    """Return a vector, turned."""
    axis = (turn.x, turn.y, turn.z)
    x, y, z = (2 * each for each in _cross(axis, vector))
    further = _cross(axis, (x, y, z))
    return tuple(v + turn.w * a + b for v, a, b in zip(vector, (x, y, z), further, strict=True))


def _cross(a: Vector, b: Vector) -> Vector:
    # Not numpy's: a solid would take as long as fifty frames.
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
