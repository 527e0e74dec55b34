"""The canonical form of a trajectory's file: one file for a rollout, byte by byte, but for its visual part.

Layout, every record as MCAP has it (opcode, 8 bytes of length, content):

    magic, header, metadata, request, samples    the evidence: exactly these bytes
    schemas, channels, chunks, message indexes   the visual part: where the request asks for one, of any content
    end of the data
    summary, footer, magic                       without a visual part exactly these bytes, else with the same indexes
                                                 of the evidence

Every version of perfbound has written the evidence in this form, so that the rules of a campaign make no difference.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping
from enum import IntEnum
from functools import lru_cache

from .errors import TrajectoryError


class _Record(IntEnum):
    """The kinds of records, as the specification of MCAP numbers them."""

    HEADER, FOOTER, SCHEMA, CHANNEL = 1, 2, 3, 4
    CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 6, 7, 8
    ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = 9, 10, 11, 12, 13
    SUMMARY_OFFSET, DATA_END = 14, 15


MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "perfbound"
EVIDENCE, REQUEST, RECORD = "trajectory.npy", "request.json", "rollout"
MEDIA_TYPES = {REQUEST: "application/json", EVIDENCE: "application/x-npy"}
"""In the order of the file."""

_RECORD = struct.Struct("<BQ")  # opcode, length of the content
_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
_VISUAL = frozenset({_Record.SCHEMA, _Record.CHANNEL, _Record.CHUNK, _Record.MESSAGE_INDEX})
_INDEXES = frozenset({_Record.ATTACHMENT_INDEX, _Record.METADATA_INDEX})
_SUMMARY = frozenset({_Record.SCHEMA, _Record.CHANNEL, _Record.STATISTICS, _Record.CHUNK_INDEX, _Record.SUMMARY_OFFSET})


def check_canonical(
    data: bytes, metadata: Mapping[str, str], attachments: Mapping[str, bytes], *, visual: bool
) -> None:
    """Check that a file whose checksums are right is the canonical one of its content; `visual`: it may be seen.

    Raises:
        TrajectoryError: with the part that is another one.

    """
    evidence, indexes = _evidence(metadata, attachments)
    footer = len(data) - len(MAGIC) - _FOOTER.size
    summary = _FOOTER.unpack_from(data, footer)[2]
    end = summary - _DATA_END.size
    if end < len(evidence) or not data.startswith(evidence):
        raise TrajectoryError("its evidence is not written as perfbound writes it")
    if end == len(evidence) and data[summary:] == _plain_end(summary, tuple(indexes)):
        return
    if not visual:
        raise TrajectoryError("it has more than the evidence, and no visual part was requested")
    if any(opcode not in _VISUAL for opcode, _ in _records(data, len(evidence), end)):
        raise TrajectoryError("its visual part has records of another kind")
    found = []
    for opcode, record in _records(data, summary, footer):
        if opcode in _INDEXES:
            found.append(record)
        elif opcode not in _SUMMARY:
            raise TrajectoryError("its summary has records of another kind")
    if found != indexes:
        raise TrajectoryError("its summary lists other evidence")


def _records(data: bytes, start: int, end: int) -> Iterator[tuple[int, bytes]]:
    while start < end:
        if end - start < _RECORD.size:
            raise TrajectoryError("a record is cut")
        opcode, length = _RECORD.unpack_from(data, start)
        after = start + _RECORD.size + length
        if after > end:
            raise TrajectoryError("a record is cut")
        yield opcode, data[start:after] if opcode in _INDEXES else b""
        start = after


def _evidence(metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> tuple[bytes, list[bytes]]:
    """Return the bytes of the evidence, and the records of the summary that list it."""
    listed = b"".join(_text(key) + _text(value) for key, value in sorted(metadata.items()))
    record = _record(_Record.METADATA, _text(RECORD) + struct.pack("<I", len(listed)) + listed)
    parts = [MAGIC + _record(_Record.HEADER, _text("") + _text(LIBRARY))]
    index = _record(_Record.METADATA_INDEX, struct.pack("<QQ", len(parts[0]), len(record)) + _text(RECORD))
    parts.append(record)
    indexes = []
    for name, media_type in MEDIA_TYPES.items():
        content = attachments[name]
        head = bytes(16) + _text(name) + _text(media_type) + struct.pack("<Q", len(content))  # no times
        crc = zlib.crc32(content, zlib.crc32(head))
        record = _record(_Record.ATTACHMENT, b"".join([head, content, struct.pack("<I", crc)]))
        place = struct.pack("<QQ", sum(map(len, parts)), len(record)) + bytes(16) + struct.pack("<Q", len(content))
        indexes.append(_record(_Record.ATTACHMENT_INDEX, place + _text(name) + _text(media_type)))
        parts.append(record)
    return b"".join(parts), [*indexes, index]


@lru_cache(maxsize=64)  # the sizes of the files of a campaign differ little
def _plain_end(summary: int, indexes: tuple[bytes, ...]) -> bytes:
    """Return everything after the data of a file without a visual part."""
    # messages, schemas, channels, attachments, metadata, chunks, first and last time, messages by channel
    statistics = _record(_Record.STATISTICS, struct.pack("<QHIIIIQQI", 0, 0, 0, len(MEDIA_TYPES), 1, 0, 0, 0, 0))
    *attachments, metadata = indexes
    groups = {
        _Record.SCHEMA: b"",
        _Record.CHANNEL: b"",
        _Record.STATISTICS: statistics,
        _Record.CHUNK_INDEX: b"",
        _Record.ATTACHMENT_INDEX: b"".join(attachments),
        _Record.METADATA_INDEX: metadata,
    }
    start, offsets = summary, b""
    for opcode, group in groups.items():
        offsets += _record(_Record.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start, len(group)))
        start += len(group)
    content = b"".join(groups.values()) + offsets
    content += _FOOTER.pack(_Record.FOOTER, 20, summary, start, 0)[:-4]
    return content + struct.pack("<I", zlib.crc32(content)) + MAGIC


def _record(opcode: int, content: bytes) -> bytes:
    return _RECORD.pack(opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data
