"""The canonical form of a trajectory's file: one file for a rollout, byte by byte, but for its visual part.

Layout, every record as MCAP has it (opcode, 8 bytes of length, content):

    magic, header, metadata, request, samples    the evidence: exactly these bytes
    schemas, channels, chunks, message indexes   the visual part: where the request asks for one, of any content
    end of the data
    summary, footer, magic                       without a visual part exactly these bytes, else with the same indexes
                                                 of the evidence

The form is the same whatever campaign the rollout belongs to.
"""

import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from functools import lru_cache

from ..errors import TrajectoryError


class Opcode(IntEnum):
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
_LENGTH, _SIZE = struct.Struct("<I"), struct.Struct("<Q")
_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
_VISUAL = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_INDEXES = frozenset({Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX})
_SUMMARY = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.SUMMARY_OFFSET})


Evidence = tuple[dict[str, str], dict[str, bytes]]
"""The metadata, and the attachments by name."""


def canonical_evidence(data: bytes, *, visual: bool) -> Evidence:
    """Return the metadata and the attachments of a canonical file whose checksums are right; `visual`: it may be seen.

    Raises:
        TrajectoryError: with the part that is not canonical.
        struct.error, UnicodeDecodeError: a length in it is wrong.

    """
    # A strict reader of this one layout costs less than that of mcap, and needs no second encoding to compare with.
    if not data.startswith(_HEAD):
        raise TrajectoryError("it is not written as perfbound writes it: its head is another one")
    metadata, after = _read_metadata(data, len(_HEAD))
    place = struct.pack("<QQ", len(_HEAD), after - len(_HEAD))
    listed = _packed(Opcode.METADATA_INDEX, place + _packed_text(RECORD))
    attachments: dict[str, bytes] = {}
    indexes = []
    for name, media_type in MEDIA_TYPES.items():
        start = after
        attachments[name], after = _attachment(data, start, name, media_type)
        place = struct.pack("<QQQQQ", start, after - start, 0, 0, len(attachments[name]))
        indexes.append(_packed(Opcode.ATTACHMENT_INDEX, place + _packed_text(name) + _packed_text(media_type)))
    _check_rest(data, after, [*indexes, listed], visual=visual)
    return metadata, attachments


def _read_metadata(data: bytes, start: int) -> tuple[dict[str, str], int]:
    """Return the metadata record that begins at `start`, and its end; the keys are sorted."""
    opcode, length = _RECORD.unpack_from(data, start)
    end, at = start + _RECORD.size + length, start + _RECORD.size
    name, at = _read_text(data, at)
    (size,) = _LENGTH.unpack_from(data, at)
    at += _LENGTH.size
    if opcode != Opcode.METADATA or name != RECORD or at + size != end:
        raise TrajectoryError("its metadata are not written as perfbound writes them")
    found: list[tuple[str, str]] = []
    while at < end:
        key, at = _read_text(data, at)
        value, at = _read_text(data, at)
        if found and key <= found[-1][0]:
            raise TrajectoryError("its metadata are not in order")
        found.append((key, value))
    if at != end:
        raise TrajectoryError("its metadata are not written as perfbound writes them")
    return dict(found), end


def _attachment(data: bytes, start: int, name: str, media_type: str) -> tuple[bytes, int]:
    """Return the attachment that begins at `start`, and the end of its record."""
    head = bytes(16) + _packed_text(name) + _packed_text(media_type)  # no times
    at = start + _RECORD.size
    (size,) = _SIZE.unpack_from(data, at + len(head))
    content = at + len(head) + _SIZE.size
    end = content + size + _LENGTH.size
    expected = _RECORD.pack(Opcode.ATTACHMENT, end - at) + head
    if data[start : start + len(expected)] != expected or end > len(data):
        raise TrajectoryError(f"its attachments are not {' and '.join(MEDIA_TYPES)}, as perfbound writes them")
    found = data[content : content + size]
    if _LENGTH.unpack_from(data, content + size)[0] != zlib.crc32(memoryview(data)[at : content + size]):
        raise TrajectoryError(f"the checksum of {name} is wrong")
    return found, end


def _check_rest(data: bytes, start: int, indexes: list[bytes], *, visual: bool) -> None:
    """Check everything behind the evidence, which `indexes` list in the summary."""
    footer = len(data) - len(MAGIC) - _FOOTER.size
    summary = _FOOTER.unpack_from(data, footer)[2]
    end = summary - _DATA_END.size
    if end == start and data[summary:] == _plain_end(summary, tuple(indexes)):
        return
    if not visual:
        raise TrajectoryError("it has more than the evidence, and no visual part was requested")
    if any(opcode not in _VISUAL for opcode, _ in _framed(data, start, end)):
        raise TrajectoryError("its visual part has records of another kind")
    found = []
    for opcode, record in _framed(data, summary, footer):
        if opcode in _INDEXES:
            found.append(record)
        elif opcode not in _SUMMARY:
            raise TrajectoryError("its summary has records of another kind")
    if found != indexes:
        raise TrajectoryError("its summary lists other evidence")


def _framed(data: bytes, start: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield the opcode of each record, and the bytes of those that list evidence."""
    while start != end:
        opcode, length = _RECORD.unpack_from(data, start)
        after = start + _RECORD.size + length
        if after > end:
            raise TrajectoryError("a record is cut")
        yield opcode, data[start:after] if opcode in _INDEXES else b""
        start = after


@lru_cache(maxsize=64)  # the sizes of the files of a campaign differ little
def _plain_end(summary: int, indexes: tuple[bytes, ...]) -> bytes:
    """Return everything after the data of a file without a visual part."""
    # messages, schemas, channels, attachments, metadata, chunks, first and last time, messages by channel
    statistics = _packed(Opcode.STATISTICS, struct.pack("<QHIIIIQQI", 0, 0, 0, len(MEDIA_TYPES), 1, 0, 0, 0, 0))
    *attachments, metadata = indexes
    groups = {
        Opcode.SCHEMA: b"",
        Opcode.CHANNEL: b"",
        Opcode.STATISTICS: statistics,
        Opcode.CHUNK_INDEX: b"",
        Opcode.ATTACHMENT_INDEX: b"".join(attachments),
        Opcode.METADATA_INDEX: metadata,
    }
    start, offsets = summary, b""
    for opcode, group in groups.items():
        offsets += _packed(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start, len(group)))
        start += len(group)
    content = b"".join(groups.values()) + offsets
    content += _FOOTER.pack(Opcode.FOOTER, 20, summary, start, 0)[:-4]
    return content + struct.pack("<I", zlib.crc32(content)) + MAGIC


def _packed(opcode: int, content: bytes) -> bytes:
    return _RECORD.pack(opcode, len(content)) + content


def _packed_text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _read_text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = _LENGTH.unpack_from(data, at)
    after = at + _LENGTH.size + length
    if after > len(data):
        raise TrajectoryError("a text is cut")
    return data[at + _LENGTH.size : after].decode(), after


_HEAD = MAGIC + _packed(Opcode.HEADER, _packed_text("") + _packed_text(LIBRARY))
