"""Messages of protobuf for all frames at once, with its bytes: its objects, one by one, take several times as long.

A field is a tag and a value. A number that is zero and a text that is empty have none; a message always has one.

| symbol | meaning |
|---|---|
| F | frames of the visual part |
"""

import functools
import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_VARINT, _FIXED_64, _WITH_LENGTH, _FIXED_32 = 0, 1, 2, 5  # kinds of values


class Fields(NamedTuple):
    """Fields of a message in each frame: in their order bytes (F, w) and which of them there are, and the sizes."""

    bytes: tuple[NDArray[np.uint8], ...]
    kept: tuple[NDArray[np.bool_], ...]
    sizes: NDArray[np.int64]  # (F,)


def numbers(values: NDArray[np.float64] | NDArray[np.float32]) -> Fields:
    """Return the fields 1 to k, one for each column of values (F, k)."""
    size, kind = values.itemsize, _FIXED_64 if values.itemsize == 8 else _FIXED_32
    bits = np.ascontiguousarray(values).view(f"<u{size}")
    tags = [_tag(number, kind) for number in range(1, values.shape[1] + 1)]
    widths = [len(tag) + size for tag in tags]
    found = _repeated(b"".join(tag + bytes(size) for tag in tags), len(values)).copy()
    found[:, np.concatenate([np.arange(end - size, end) for end in np.cumsum(widths)])] = bits.view(np.uint8)
    present = bits != 0  # as bits: -0.0 is no zero
    return Fields((found,), (np.repeat(present, widths, axis=1),), present @ np.array(widths))


def integers(number: int, values: NDArray[np.int64]) -> Fields:
    """Return a field for values (F,) of at least 0."""
    (value,), (kept,), sizes = _varints(values)
    tag, present = _tag(number, _VARINT), values != 0
    found = np.hstack((_repeated(tag, len(values)), value))
    kept = np.hstack((_repeated(b"\1" * len(tag), len(values)).astype(np.bool_), kept)) & present[:, np.newaxis]
    return Fields((found,), (kept,), np.where(present, len(tag) + sizes, 0))


def text(number: int, content: str, frames: int) -> Fields:
    """Return a field for the same text in all frames."""
    data = content.encode()
    return _same(_tag(number, _WITH_LENGTH) + _varint(len(data)) + data if data else b"", frames)


def message(number: int, *fields: Fields) -> Fields:
    """Return a field for a message with these fields."""
    content = _joined(*fields)
    return _joined(_same(_tag(number, _WITH_LENGTH), len(content.sizes)), _varints(content.sizes), content)


def rows(*fields: Fields) -> list[bytes]:
    """Return the message of each frame, with these fields."""
    whole = _joined(*fields)
    data, ends = np.hstack(whole.bytes)[np.hstack(whole.kept)].tobytes(), np.cumsum(whole.sizes).tolist()
    return [data[start:end] for start, end in itertools.pairwise((0, *ends))]


def _joined(*fields: Fields) -> Fields:
    found, kept, sizes = zip(*fields, strict=True)
    return Fields(sum(found, ()), sum(kept, ()), sum(sizes))


def _same(data: bytes, frames: int) -> Fields:
    kept = np.broadcast_to(np.True_, (frames, len(data)))
    return Fields((_repeated(data, frames),), (kept,), np.full(frames, len(data)))


def _repeated(data: bytes, frames: int) -> NDArray[np.uint8]:
    return np.broadcast_to(np.frombuffer(data, np.uint8), (frames, len(data)))


def _varints(values: NDArray[np.int64]) -> Fields:
    """Return integers (F,) of at least 0: seven bits in each byte, the lowest first, and a mark on all but the last."""
    longest = max(-(-int(values.max(initial=0)).bit_length() // 7), 1)
    rest = values[:, np.newaxis] >> 7 * np.arange(longest + 1)
    more = rest[:, 1:] > 0
    found = (rest[:, :-1] & 127 | more << 7).astype(np.uint8)
    kept = np.hstack((np.ones_like(more[:, :1]), more[:, :-1]))
    return Fields((found,), (kept,), kept.sum(axis=1))


@functools.lru_cache(maxsize=1024)
def _varint(value: int) -> bytes:
    return rows(_varints(np.array([value])))[0]


def _tag(number: int, kind: int) -> bytes:
    return _varint(8 * number + kind)
