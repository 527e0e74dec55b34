"""Blocks of a large computation: parts of its rows whose intermediate arrays stay small."""

from collections.abc import Iterator

LARGEST = 2**22
"""Numbers of one intermediate array: 34 MB."""
ALIGNED = 64
"""Rows of a block are a multiple of it, so that products of matrices are divided as they are without blocks."""


def blocks(count: int, width: int, largest: int = LARGEST) -> Iterator[slice]:
    """Yield slices that cover `count` rows, each of as many rows of `width` numbers as `largest` numbers have.

    At least one, so that an empty array keeps its shape.

    >>> list(blocks(5, 10, largest=20))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    >>> list(blocks(0, 10))
    [slice(0, 0, None)]
    """
    rows = max(1, largest // max(1, width))
    rows -= rows % ALIGNED if rows > ALIGNED else 0
    for start in range(0, max(1, count), rows):
        yield slice(start, min(start + rows, count))
