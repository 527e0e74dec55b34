"""Running what is missing, with progress on stderr."""

import sys
import time
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path

from tests.studies.coverage.records import DIRECTORY, Chunk, Row, append, read
from tests.studies.coverage.study import CHUNK, one_chunk

Work = tuple[Row, int]


def missing(rows: Sequence[Row], chunks: int, directory: Path = DIRECTORY) -> list[Work]:
    """Return the chunks that no earlier run has finished, every row's first one first: a table is there early."""
    done = [read(row, directory).keys() for row in rows]
    return [
        (row, number) for number in range(chunks) for row, have in zip(rows, done, strict=True) if number not in have
    ]


def run(rows: Sequence[Row], campaigns: int, workers: int, directory: Path = DIRECTORY) -> None:
    """Run all missing campaigns of every row, up to `campaigns`, and append what they found."""
    work = missing(rows, -(-campaigns // CHUNK), directory)
    start = time.monotonic()
    for done, (row, number, chunk) in enumerate(_results(work, workers), start=1):
        append(row, number, chunk, directory)
        left = (time.monotonic() - start) / done * (len(work) - done)
        sys.stderr.write(
            f"{row.kind:12s} campaigns {number * CHUNK} to {(number + 1) * CHUNK - 1}; "
            f"chunk {done} of {len(work)}, {left / 60:.1f} min left\n"
        )


def _results(work: Sequence[Work], workers: int) -> Iterator[tuple[Row, int, Chunk]]:
    if workers == 1:
        yield from map(_one, work)
        return
    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(_one, work)


def _one(work: Work) -> tuple[Row, int, Chunk]:
    row, number = work
    return row, number, one_chunk(row, number)
