"""The limits within a trajectory's file: what is decoded takes a small multiple of its bytes."""

import struct

from mcap.opcode import Opcode

from .canonical import MAGIC
from .errors import TrajectoryError

MAX_NAMES = 2**20
"""Bytes of all that becomes objects of Python: in memory they take thirty times as much."""
MAX_RECORDS = 10_000
_RECORD = struct.Struct("<BQ")  # opcode, length


def check_sizes(data: bytes) -> None:
    """Refuse a file of many records, or with more than one large attachment: all but the samples become objects.

    Raises:
        TrajectoryError: it is one.
        struct.error: a length in it is wrong.

    """
    at, small, largest = len(MAGIC), 0, 0
    for _ in range(MAX_RECORDS):
        opcode, length = _RECORD.unpack_from(data, at)
        if opcode in (Opcode.CHUNK, Opcode.DATA_END):
            break
        small, at = small + length, at + _RECORD.size + length
        largest = max(largest, length) if opcode == Opcode.ATTACHMENT else largest
    else:
        raise TrajectoryError(f"more than {MAX_RECORDS} records")
    if small - largest > MAX_NAMES:
        raise TrajectoryError(f"{small - largest} bytes beside the samples are more than {MAX_NAMES}")


def check_length(name: str, content: bytes) -> None:
    """Refuse an attachment that is parsed into objects, if it is large; raises `TrajectoryError`."""
    if len(content) > MAX_NAMES:
        raise TrajectoryError(f"{name} has {len(content)} bytes, more than {MAX_NAMES}")
