"""Files of strangers: what is decoded takes a small multiple of the file, whatever it claims to contain."""

import io
import json
import tracemalloc

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from perfbound.schemas.errors import TrajectoryError
from perfbound.schemas.trajectory.canonical import EVIDENCE, RECORD, REQUEST
from perfbound.schemas.trajectory.file_checks import MAX_NAMES
from perfbound.schemas.trajectory.npy import to_npy
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap

SAMPLES = to_npy(np.array([[0.0, 1.0]]))
COLUMNS = json.dumps(["t", "x"])


def a_file(
    request: bytes = b"{}", columns: str = COLUMNS, more: str = "", content: bytes = b"", samples: bytes = SAMPLES
) -> bytes:
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile="", library="perfbound")
    writer.add_metadata(RECORD, {"columns": columns, "more": more})
    writer.add_attachment(0, 0, REQUEST, "application/json", request)
    writer.add_attachment(0, 0, EVIDENCE, "application/x-npy", samples)
    if content:
        channel = writer.register_channel("/state", "json", writer.register_schema("s", "jsonschema", b"{}"))
        writer.add_message(channel, 0, content, 0)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def peak_of_reading(file: bytes) -> int:
    """Return the largest number of bytes that reading a file takes beside it."""
    tracemalloc.start()
    try:
        read_mcap(file)
    except TrajectoryError:
        pass
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peak


@pytest.mark.parametrize(
    "file",
    [
        a_file(columns=json.dumps(["a"] * 1_000_000)),
        a_file(request=json.dumps({"x": [[]] * 1_000_000}, separators=(",", ":")).encode()),
        a_file(more="x" * 5_000_000),
        a_file(columns="[" * 5_000_000),
    ],
    ids=["columns", "request", "metadata", "depth"],
)
def test_names_that_would_become_many_objects_are_refused_unread(file: bytes) -> None:
    with pytest.raises(TrajectoryError, match=f"more than {MAX_NAMES}"):
        read_mcap(file)
    assert peak_of_reading(file) < 1.5 * len(file)


@pytest.mark.rest
def test_names_below_the_limit_take_a_bounded_multiple() -> None:
    file = a_file(request=json.dumps({"x": [[]] * (MAX_NAMES // 3 - 10)}, separators=(",", ":")).encode())
    read_mcap(file)
    assert peak_of_reading(file) < 64 * MAX_NAMES


def test_a_large_trajectory_takes_three_times_its_file() -> None:
    t = np.arange(500_000) / 100
    file = encode(Trajectory(("t", "x"), np.column_stack([t, t])), request={}, metadata={}, units={"t": "s", "x": ""})
    assert read_mcap(file).trajectory.samples.shape == (500_000, 2)
    assert peak_of_reading(file) < 4 * len(file)


def test_a_visual_part_is_never_decompressed() -> None:
    bomb = a_file(content=bytes(50_000_000))
    assert len(bomb) < 100_000
    assert read_mcap(bomb).trajectory.columns == ("t", "x")
    assert peak_of_reading(bomb) < 1_000_000
