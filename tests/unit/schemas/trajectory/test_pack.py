"""Messages that are packed for all frames at once, against the objects of protobuf."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from perfbound.schemas.trajectory import pack

ODD = st.sampled_from([0.0, -0.0, 1.0, 5e-324, -1e308])
TIMES = st.integers(0, 2**63 - 1) | st.sampled_from([0, 1, 10**9 - 1, 10**9, 127 * 10**9, 128 * 10**9])


@given(st.lists(TIMES, min_size=1, max_size=9), st.text(max_size=200), st.data())
def test_transforms(times: list[int], name: str, data: st.DataObject) -> None:
    moves = data.draw(arrays.arrays(np.float64, (len(times), 7), elements=ODD | st.floats(allow_nan=False)))
    stamps = np.array(times)
    stamp = pack.message(1, pack.integers(1, stamps // 10**9), pack.integers(2, stamps % 10**9))
    named = pack.text(2, name, len(times)), pack.text(3, "b", len(times))
    moved = pack.message(4, pack.numbers(moves[:, :3])), pack.message(5, pack.numbers(moves[:, 3:]))
    found = pack.rows(pack.message(1, stamp, *named, *moved), pack.message(1, pack.text(2, "", len(times))))
    for row, time, values in zip(found, times, moves.tolist(), strict=True):
        message = FrameTransforms()
        each = message.transforms.add(parent_frame_id=name, child_frame_id="b")
        each.timestamp.seconds, each.timestamp.nanos = divmod(time, 10**9)
        each.translation.x, each.translation.y, each.translation.z = values[:3]
        each.rotation.x, each.rotation.y, each.rotation.z, each.rotation.w = values[3:]
        message.transforms.add()
        assert row == message.SerializeToString(deterministic=True)


@pytest.mark.parametrize("count", [1, 15, 16, 40])
@given(st.data())
def test_numbers_of_single_precision(count: int, data: st.DataObject) -> None:
    file = FileDescriptorProto(name=f"{count}.proto", syntax="proto3")
    kind = file.message_type.add(name="State")
    for number in range(1, count + 1):
        kind.field.add(name=f"c{number}", number=number, type=FieldDescriptorProto.TYPE_FLOAT, label="LABEL_OPTIONAL")
    described = DescriptorPool().AddSerializedFile(file.SerializeToString()).message_types_by_name["State"]
    rows = data.draw(arrays.arrays(np.float64, (3, count), elements=ODD | st.floats(allow_nan=False)))
    with np.errstate(over="ignore"):
        found = pack.rows(pack.numbers(rows.astype(np.float32)))
    for row, values in zip(found, rows.tolist(), strict=True):
        message = GetMessageClass(described)(**{f"c{k}": value for k, value in enumerate(values, start=1)})
        assert row == message.SerializeToString(deterministic=True)
