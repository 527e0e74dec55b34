"""The columns of a trajectory as numbers over time, one channel each: what a viewer plots of a system without a scene.

A message is a Float64MultiArray of ROS with one number. rerun plots it by itself, and no other message of plain
numbers; Foxglove plots the fields of any message. All messages are built at once, as one array: one by one they would
take longer than many a rollout.

| symbol | meaning |
|---|---|
| T | samples of a trajectory |
| n | columns of the trajectory, the first one is the time `t` |
| R | samples that are shown |
"""

import struct
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MESSAGE, SCHEMA_ENCODING, ENCODING = "std_msgs/msg/Float64MultiArray", "ros2msg", "cdr"
DEFINITION = b"""std_msgs/MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
NUMBERS = 20_000
"""Shown at most; of a longer trajectory every second sample, or every third, ... The evidence has all of them."""
COLUMNS = 1000
"""Shown at most, the first ones."""
LAST_TIME = 9e9
"""Seconds; a later sample is shown at this time, because 64 bits of nanoseconds end there."""

_MESSAGE, _MESSAGE_INDEX = 0x05, 0x07  # opcodes of MCAP
_LENGTH = struct.Struct("<BQH")  # opcode, length of the rest, channel
_INDEX = struct.Struct("<BQHI")  # the same, and the length of the entries
# Little-endian; no dimensions, no offset, one number, four bytes up to a multiple of eight.
_BEFORE_NUMBER = struct.pack("<4s3I4x", b"\0\1\0\0", 0, 0, 1)
_RECORD = np.dtype(
    [("head", "V11"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8"), ("cdr", "V20"), ("number", "<f8")]
)
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


class Messages(NamedTuple):
    """The messages of all channels: records of a chunk in the order of time, and an index record for each channel."""

    records: bytearray
    indexes: tuple[bytes, ...]
    each: int
    """Messages of each channel."""
    first: int
    """Nanoseconds, as `last`."""
    last: int


def shown(columns: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns that have a channel: all but the time."""
    return columns[1 : COLUMNS + 1]


def messages(samples: NDArray[np.float64], start: int) -> Messages:
    """Return the messages of `samples`, shape (T, n), for channels 1, 2, ...; `start` is their offset in the chunk."""
    channels = min(samples.shape[1] - 1, COLUMNS)
    rows = samples[:: -(-len(samples) * channels // NUMBERS)]
    times = np.rint(np.minimum(rows[:, 0], LAST_TIME) * 1e9).astype("<u8")
    records, entries = (bytearray(each) for each in _blank(len(rows), channels))
    # As one array: the writer of mcap takes thirty times as long, a message at a time.
    filled = np.frombuffer(records, _RECORD).reshape(-1, channels)
    filled["log"] = filled["publish"] = times[:, np.newaxis]
    filled["number"] = rows[:, 1 : channels + 1]
    listed = np.frombuffer(entries, _ENTRY).reshape(channels, -1)
    listed["time"] = times
    listed["offset"] += np.uint64(start)
    size = len(entries) // channels
    indexes = tuple(
        _INDEX.pack(_MESSAGE_INDEX, 6 + size, 1 + k, size) + entries[k * size : (k + 1) * size] for k in range(channels)
    )
    return Messages(records, indexes, len(rows), int(times[0]), int(times[-1]))


@lru_cache(maxsize=4)
def _blank(rows: int, channels: int) -> tuple[bytes, bytes]:
    """Return the records without times and numbers, row by row, and the index entries without times, by channel."""
    records, entries = np.zeros((rows, channels), _RECORD), np.zeros((channels, rows), _ENTRY)
    length = _RECORD.itemsize - 9  # without opcode and length
    records["head"] = np.array([_LENGTH.pack(_MESSAGE, length, 1 + k) for k in range(channels)], dtype="V11")
    records["cdr"] = np.void(_BEFORE_NUMBER)
    entries["offset"] = _RECORD.itemsize * np.arange(records.size, dtype="<u8").reshape(records.shape).T
    return records.tobytes(), entries.tobytes()
