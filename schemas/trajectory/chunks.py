"""The file of evidence with a visual part: chunks of messages, and a summary that lists them.

The bytes are those that the writer of mcap gives; it makes a message in a dozen calls, which take longer than the rest
of the file of a Segway.
"""

import struct
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import zstandard

from .canonical import DATA_END, Opcode, packed, packed_text, statistics, summary_of

CHUNK_BYTES = 65536
"""A chunk ends with the message that makes it longer."""

_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length of the rest, channel, sequence, time, time of publication
_INDEX = struct.Struct("<BQHI")  # opcode, length of the rest, channel, length of the entries
_ENTRY = 16  # bytes: time, offset in the chunk
_CHUNK = struct.Struct("<QQQI")  # first and last time, size and crc of the content
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last time, offset and length of the chunk, length of the places
_COMPRESSION = packed_text("zstd")


class Chunk(NamedTuple):
    """Records of types, channels and messages, and for each channel with messages the record that lists them."""

    content: bytes | bytearray
    first: int
    """Nanoseconds, as `last`."""
    last: int
    indexes: Mapping[int, bytes]


def type_record(number: int, name: str, encoding: str, data: bytes) -> bytes:
    """Return the record of a type of messages."""
    texts = packed_text(name) + packed_text(encoding)
    return packed(Opcode.SCHEMA, struct.pack("<H", number) + texts + struct.pack("<I", len(data)) + data)


def channel_record(number: int, kind: int, topic: str, encoding: str, metadata: Mapping[str, str]) -> bytes:
    """Return the record of a channel whose messages have the type of number `kind`."""
    pairs = b"".join(packed_text(key) + packed_text(value) for key, value in metadata.items())
    texts = packed_text(topic) + packed_text(encoding)
    return packed(Opcode.CHANNEL, struct.pack("<HH", number, kind) + texts + struct.pack("<I", len(pairs)) + pairs)


def chunked(definitions: Sequence[bytes], messages: Iterable[tuple[int, int, bytes]]) -> Iterator[Chunk]:
    """Yield the chunks with the records of types and channels, and messages (ns, channel, content), in their order.

    The times do not decrease.
    """
    records, size = list(definitions), sum(map(len, definitions))
    entries: dict[int, list[int]] = {}
    first = last = 0
    for last, channel, data in messages:
        first = first if entries else last
        entries.setdefault(channel, []).extend((last, size))
        records += (_MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE.size - 9 + len(data), channel, 0, last, last), data)
        size += _MESSAGE.size + len(data)
        if size > CHUNK_BYTES:
            yield Chunk(b"".join(records), first, last, _indexes(entries))
            records, size, entries = [], 0, {}
    if entries:
        yield Chunk(b"".join(records), first, last, _indexes(entries))


def _indexes(entries: Mapping[int, list[int]]) -> dict[int, bytes]:
    found = {}
    for channel, numbers in entries.items():
        size = 8 * len(numbers)
        found[channel] = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - 9 + size, channel, size)
        found[channel] += struct.pack(f"<{len(numbers)}Q", *numbers)
    return found


def seen_file(
    parts: Sequence[bytes],
    listed: Sequence[bytes],
    definitions: Sequence[bytes],
    chunks: Iterable[Chunk],
    *,
    level: int = 3,
    offsets: bool = True,
) -> bytes:
    """Return the file of the evidence in `parts`, of which the summary has the records `listed`, with these chunks.

    `level` is that of the compression. With `offsets` the summary says where each of its groups begins.
    """
    data, at = list(parts), sum(map(len, parts))
    counts: dict[int, int] = {}
    found: list[bytes] = []
    times: list[int] = []
    for chunk in chunks:
        body = _compressed(chunk.content, level)
        sizes = _CHUNK.pack(chunk.first, chunk.last, len(chunk.content), zlib.crc32(chunk.content))
        record = packed(Opcode.CHUNK, sizes + _COMPRESSION + struct.pack("<Q", len(body)) + body)
        places, after = b"", at + len(record)
        for channel, index in chunk.indexes.items():
            places += struct.pack("<HQ", channel, after)
            after += len(index)
            counts[channel] = counts.get(channel, 0) + (len(index) - _INDEX.size) // _ENTRY
        head = _CHUNK_INDEX.pack(chunk.first, chunk.last, at, len(record), len(places))
        ends = struct.pack("<Q", after - at - len(record)), struct.pack("<QQ", len(body), len(chunk.content))
        found.append(packed(Opcode.CHUNK_INDEX, head + places + ends[0] + _COMPRESSION + ends[1]))
        data += (record, *chunk.indexes.values())
        times += (chunk.first, chunk.last)
        at = after
    *attachments, metadata = listed
    kinds, channels = ([each for each in definitions if each[0] == kind] for kind in (Opcode.SCHEMA, Opcode.CHANNEL))
    groups = {
        Opcode.SCHEMA: b"".join(kinds),
        Opcode.CHANNEL: b"".join(channels),
        Opcode.STATISTICS: statistics((len(kinds), len(channels), len(attachments), len(found)), times, counts),
        Opcode.CHUNK_INDEX: b"".join(found),
        Opcode.ATTACHMENT_INDEX: b"".join(attachments),
        Opcode.METADATA_INDEX: metadata,
    }
    whole = b"".join(data)
    end = DATA_END.pack(Opcode.DATA_END, 4, zlib.crc32(whole))
    return b"".join((whole, end, summary_of(at + len(end), groups, offsets=offsets)))


class _Compressors(threading.local):
    """One for each thread and level: making one takes as long as its work here, and no thread may use another's."""

    def __init__(self) -> None:
        self.of_level: dict[int, zstandard.ZstdCompressor] = {}


_compressors = _Compressors()


def _compressed(content: bytes | bytearray, level: int) -> bytes:
    found = _compressors.of_level
    if level not in found:
        found[level] = zstandard.ZstdCompressor(level=level)
    return found[level].compress(content)
