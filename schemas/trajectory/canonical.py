"""The canonical form of a file of trajectories: one file for a rollout or a batch, byte by byte, but for a visual part.

Layout, every record as MCAP has it (opcode, 8 bytes of length, content):

    magic, header, metadata, attachments         the evidence: exactly these bytes
    schemas, channels, chunks, message indexes   the visual part: where the request asks for one, of any content
    end of the data
    summary, footer, magic                       without a visual part exactly these bytes, else with the same indexes
                                                 of the evidence

The form is the same whatever campaign the rollout belongs to.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

from ..errors import TrajectoryError


class Opcode(IntEnum):
    """The kinds of records, as the specification of MCAP numbers them."""

    HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE = 1, 2, 3, 4, 5
    CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 6, 7, 8
    ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = 9, 10, 11, 12, 13
    SUMMARY_OFFSET, DATA_END = 14, 15


MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "perfbound"
EVIDENCE, REQUEST, RECORD = "trajectory.npy", "request.json", "rollout"
TIME, FAILURES = "time.npy", "failures.json"
KEPT, DIGESTS, SCORES = "kept.json", "digests.bin", "scores.npy"
JSON, NPY, BINARY = "application/json", "application/x-npy", "application/octet-stream"


@dataclass(frozen=True, slots=True)
class Layout:
    """What the evidence of a file consists of."""

    record: str
    """The name of its metadata record."""
    media_types: tuple[tuple[str, str], ...]
    """The name of each attachment and its type, in the order of the file."""
    optional: str | None = None
    """The one attachment that a file may lack."""


OF_ROLLOUT = Layout(RECORD, ((REQUEST, JSON), (EVIDENCE, NPY)))
OF_BATCH = Layout("batch", ((REQUEST, JSON), (TIME, NPY), (EVIDENCE, NPY), (FAILURES, JSON)), optional=FAILURES)
OF_REDUCED = Layout(
    "reduced",
    (
        *((REQUEST, JSON), (TIME, NPY), (KEPT, JSON), (EVIDENCE, NPY)),
        *((DIGESTS, BINARY), (SCORES, NPY), (FAILURES, JSON)),
    ),
    optional=FAILURES,
)

_RECORD = struct.Struct("<BQ")  # opcode, length of the content
_LENGTH, _SIZE = struct.Struct("<I"), struct.Struct("<Q")
DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
_VISUAL = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_INDEXES = frozenset({Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX})
_SUMMARY = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.SUMMARY_OFFSET})


Evidence = tuple[dict[str, str], dict[str, bytes]]
"""The metadata, and the attachments by name."""


def evidence_of(
    layout: Layout, metadata: Mapping[str, str], attachments: Mapping[str, bytes]
) -> tuple[list[bytes], tuple[bytes, ...]]:
    """Return the parts of a file with this evidence, up to the end of its data, and what its summary lists of them."""
    pairs = b"".join(packed_text(key) + packed_text(value) for key, value in sorted(metadata.items()))
    record = packed(Opcode.METADATA, packed_text(layout.record) + _LENGTH.pack(len(pairs)) + pairs)
    parts, indexes, at = [_HEAD, record], list[bytes](), len(_HEAD) + len(record)
    for name, media_type in layout.media_types:
        if name not in attachments:
            continue
        content = attachments[name]
        head = _attachment_head(name, media_type, len(content))
        crc = zlib.crc32(content, zlib.crc32(memoryview(head)[_RECORD.size :]))
        parts += [head, content, _LENGTH.pack(crc)]
        length = len(head) + len(content) + _LENGTH.size
        indexes.append(_attachment_index(name, media_type, at, length, len(content)))
        at += length
    return parts, (*indexes, _metadata_index(layout, len(record)))


def canonical_file(layout: Layout, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> bytes:
    """Return the one file with this evidence and no visual part."""
    parts, indexes = evidence_of(layout, metadata, attachments)
    crc = 0
    for part in parts:
        crc = zlib.crc32(part, crc)
    summary = sum(map(len, parts)) + DATA_END.size
    return b"".join([*parts, DATA_END.pack(Opcode.DATA_END, 4, crc), _plain_end(summary, indexes)])


def is_of(layout: Layout, data: bytes) -> bool:
    """Whether a file claims to have this layout; nothing else of it is checked."""
    name = packed_text(layout.record)
    return data[len(_HEAD) + _RECORD.size :][: len(name)] == name


def canonical_evidence(data: bytes, layout: Layout, *, visual: bool) -> Evidence:
    """Return the metadata and the attachments of a canonical file whose checksums are right; `visual`: it may be seen.

    Raises:
        TrajectoryError: with the part that is not canonical.
        struct.error, UnicodeDecodeError: a length in it is wrong.

    """
    # A strict reader of this one layout costs less than that of mcap, and needs no second encoding to compare with.
    if not data.startswith(_HEAD):
        raise TrajectoryError("it is not written as perfbound writes it: its head is another one")
    metadata, after = _read_metadata(data, len(_HEAD), layout.record)
    listed = _metadata_index(layout, after - len(_HEAD))
    attachments: dict[str, bytes] = {}
    indexes = []
    for name, media_type in layout.media_types:
        start = after
        found = _attachment(data, start, name, media_type)
        if found is None:
            if name == layout.optional:
                continue
            names = [each for each, _ in layout.media_types if each != layout.optional]
            raise TrajectoryError(f"its attachments are not {' and '.join(names)}, as perfbound writes them")
        attachments[name], after = found
        indexes.append(_attachment_index(name, media_type, start, after - start, len(attachments[name])))
    _check_rest(data, after, [*indexes, listed], visual=visual)
    return metadata, attachments


def _metadata_index(layout: Layout, length: int) -> bytes:
    return packed(Opcode.METADATA_INDEX, struct.pack("<QQ", len(_HEAD), length) + packed_text(layout.record))


@lru_cache(maxsize=64)  # the sizes of the files of a campaign differ little
def _attachment_index(name: str, media_type: str, start: int, length: int, size: int) -> bytes:
    place = struct.pack("<QQQQQ", start, length, 0, 0, size)
    return packed(Opcode.ATTACHMENT_INDEX, place + packed_text(name) + packed_text(media_type))


@lru_cache(maxsize=64)
def _attachment_head(name: str, media_type: str, size: int) -> bytes:
    """Return the bytes of an attachment's record before its content of `size` bytes."""
    head = bytes(16) + packed_text(name) + packed_text(media_type) + _SIZE.pack(size)  # no times
    return _RECORD.pack(Opcode.ATTACHMENT, len(head) + size + _LENGTH.size) + head


def _read_metadata(data: bytes, start: int, record: str) -> tuple[dict[str, str], int]:
    """Return the metadata record that begins at `start`, and its end; the keys are sorted."""
    opcode, length = _RECORD.unpack_from(data, start)
    end, at = start + _RECORD.size + length, start + _RECORD.size
    name, at = _read_text(data, at)
    (size,) = _LENGTH.unpack_from(data, at)
    at += _LENGTH.size
    if opcode != Opcode.METADATA or name != record or at + size != end:
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


def _attachment(data: bytes, start: int, name: str, media_type: str) -> tuple[bytes, int] | None:
    """Return the attachment that begins at `start`, and the end of its record; None if another record begins there."""
    before = len(_attachment_head(name, media_type, 0)) - _SIZE.size
    (size,) = _SIZE.unpack_from(data, start + before)
    content = start + before + _SIZE.size
    end = content + size + _LENGTH.size
    if data[start:content] != _attachment_head(name, media_type, size) or end > len(data):
        return None
    found = data[content : content + size]
    checked = memoryview(data)[start + _RECORD.size : content + size]
    if _LENGTH.unpack_from(data, content + size)[0] != zlib.crc32(checked):
        raise TrajectoryError(f"the checksum of {name} is wrong")
    return found, end


def _check_rest(data: bytes, start: int, indexes: list[bytes], *, visual: bool) -> None:
    """Check everything behind the evidence, which `indexes` list in the summary."""
    footer = len(data) - len(MAGIC) - _FOOTER.size
    summary = _FOOTER.unpack_from(data, footer)[2]
    end = summary - DATA_END.size
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


@lru_cache(maxsize=64)
def _plain_end(summary: int, indexes: tuple[bytes, ...]) -> bytes:
    """Return everything after the data of a file without a visual part."""
    *attachments, metadata = indexes
    groups = {
        Opcode.SCHEMA: b"",
        Opcode.CHANNEL: b"",
        Opcode.STATISTICS: statistics((0, 0, len(attachments), 0), (), {}),
        Opcode.CHUNK_INDEX: b"",
        Opcode.ATTACHMENT_INDEX: b"".join(attachments),
        Opcode.METADATA_INDEX: metadata,
    }
    return summary_of(summary, groups)


def statistics(numbers: tuple[int, int, int, int], times: Sequence[int], counts: Mapping[int, int]) -> bytes:
    """Return the record that counts the others.

    `numbers` are those of types, channels, attachments and chunks; `times` those of messages; `counts` the numbers of
    messages by channel.
    """
    kinds, channels, attachments, chunks = numbers
    first, last = (min(times), max(times)) if times else (0, 0)
    each = b"".join(struct.pack("<HQ", *pair) for pair in counts.items())
    totals = sum(counts.values()), kinds, channels, attachments, 1, chunks, first, last, len(each)
    return packed(Opcode.STATISTICS, struct.pack("<QHIIIIQQI", *totals) + each)


def summary_of(start: int, groups: Mapping[Opcode, bytes], *, offsets: bool = True) -> bytes:
    """Return the end of a file from `start` on: these records, with `offsets` the places of the groups, the footer."""
    at, places = start, b""
    for opcode, group in groups.items():
        places += packed(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, at, len(group)))
        at += len(group)
    content = b"".join(groups.values()) + (places if offsets else b"")
    content += _FOOTER.pack(Opcode.FOOTER, 20, start, at if offsets else 0, 0)[:-4]
    return content + struct.pack("<I", zlib.crc32(content)) + MAGIC


def packed(opcode: int, content: bytes) -> bytes:
    """Return a record."""
    return _RECORD.pack(opcode, len(content)) + content


def packed_text(text: str) -> bytes:
    """Return a text in a record."""
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _read_text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = _LENGTH.unpack_from(data, at)
    after = at + _LENGTH.size + length
    if after > len(data):
        raise TrajectoryError("a text is cut")
    return data[at + _LENGTH.size : after].decode(), after


_HEAD = MAGIC + packed(Opcode.HEADER, packed_text("") + packed_text(LIBRARY))
