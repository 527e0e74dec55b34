"""Arrays as bytes of numpy's own format, written in one way and read without its parser."""

import io
import re
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import TrajectoryError

Floats = NDArray[np.float64]
MAX_HEADER = 128

_SHAPE = re.compile(rb"'shape': \((\d{1,9}(?:, \d{1,9}){0,2}),?\)")


def to_npy(array: Floats) -> bytes:
    """Return the bytes of a float64 array in C order, of one to three dimensions."""
    # Of megabytes a second copy would take longer than the first.
    return b"".join((_header(array.shape), np.ascontiguousarray(array).data))


def from_npy(name: str, data: bytes, dimensions: int) -> Floats:
    """Return the array (a view of `data`) in bytes that are written as `to_npy` writes them.

    numpy's own reader passes the header to a parser of Python, and allocates whatever shape it claims.

    Raises:
        TrajectoryError: they are not; the message begins with `name`.

    """
    found = _SHAPE.search(data[:MAX_HEADER])
    shape = () if found is None else tuple(map(int, found[1].split(b", ")))
    if len(shape) != dimensions:
        raise TrajectoryError(f"{name} is not an array of float64 in {dimensions} dimensions, as perfbound writes it")
    header, size = _header(shape), 8
    for length in shape:
        size *= length
    if not data.startswith(header) or len(data) - len(header) != size:
        raise TrajectoryError(f"{name} claims the shape {shape} for {len(data)} bytes")
    return np.frombuffer(data, dtype=np.float64, offset=len(header)).reshape(shape)


@lru_cache(maxsize=64)
def _header(shape: tuple[int, ...]) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return out.getvalue()
