"""The checks of a trajectory's file before it is decoded: its checksums, and limits within it.

What is decoded takes a small multiple of the bytes of the file.
"""

import struct
import zlib

from ..errors import TrajectoryError
from ..ranges import MAX_FILE_BYTES
from .canonical import MAGIC, Opcode

MAX_NAMES = 2**20
"""Bytes of all that becomes objects of Python: in memory they take thirty times as much."""
MAX_RECORDS = 10_000
_RECORD = struct.Struct("<BQ")  # opcode, length
_DATA_END = struct.Struct("<BQI")  # opcode, length, crc of everything before
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, crc of the summary


def check_checksums(data: bytes) -> None:
    """Refuse a file of which any byte changed.

    The reader of mcap leaves out a checksum that is zero, those of attachments and that of the summary.
    """
    if not len(MAGIC) + _DATA_END.size + _FOOTER.size + len(MAGIC) <= len(data) <= MAX_FILE_BYTES:
        raise TrajectoryError(f"a file of {len(data)} bytes is empty, cut or above {MAX_FILE_BYTES}")
    view, footer = memoryview(data), len(data) - len(MAGIC) - _FOOTER.size
    opcode, _, summary, _, summary_crc = _FOOTER.unpack_from(data, footer)
    if opcode != Opcode.FOOTER or not data.startswith(MAGIC) or not data.endswith(MAGIC):
        raise TrajectoryError("not an MCAP file, or it was cut")
    if not _DATA_END.size <= summary <= footer or zlib.crc32(view[summary : -len(MAGIC) - 4]) != summary_crc:
        raise TrajectoryError("the checksum of the summary is wrong")
    end = summary - _DATA_END.size
    if view[end:summary] != _DATA_END.pack(Opcode.DATA_END, 4, zlib.crc32(view[:end])):
        raise TrajectoryError("the checksum of the data is wrong")


def check_sizes(data: bytes, arrays: int = 1) -> None:
    """Refuse a file of many records, or with more large attachments than `arrays`: all but these become objects.

    Raises:
        TrajectoryError: it is one.
        struct.error: a length in it is wrong.

    """
    at, small, attachments = len(MAGIC), 0, list[int]()
    for _ in range(MAX_RECORDS):
        opcode, length = _RECORD.unpack_from(data, at)
        if opcode in (Opcode.CHUNK, Opcode.DATA_END):
            break
        small, at = small + length, at + _RECORD.size + length
        attachments += [length] if opcode == Opcode.ATTACHMENT else []
    else:
        raise TrajectoryError(f"more than {MAX_RECORDS} records")
    small -= sum(sorted(attachments)[-arrays:])
    if small > MAX_NAMES:
        raise TrajectoryError(f"{small} bytes beside the samples are more than {MAX_NAMES}")


def check_length(name: str, content: bytes) -> None:
    """Refuse an attachment that is parsed into objects, if it is large; raises `TrajectoryError`."""
    if len(content) > MAX_NAMES:
        raise TrajectoryError(f"{name} has {len(content)} bytes, more than {MAX_NAMES}")
