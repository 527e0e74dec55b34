"""Read-only connections of the SQLite driver to a campaign database, whose file is untrusted."""

import json
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from ...schemas.ranges import LARGEST_BATCH
from .damage import naming_cause
from .lock import is_held
from .rows import existing

LONGEST = 2**26
"""Bytes of one value."""


@contextmanager
def snapshot(directory: Path) -> Iterator[sqlite3.Connection]:
    """Open the database of a campaign at one moment in time, by the driver alone: SQLAlchemy takes long to load.

    Raises:
        JournalError: there is none, or it is damaged.
        OSError: the disk is full or fails.

    """
    path = existing(directory).resolve()
    with naming_cause(directory), closing(open_readonly(path, immutable=is_still(directory, path))) as connection:
        connection.execute("BEGIN")  # one snapshot for all queries, while the orchestrator commits
        yield connection


def open_readonly(path: Path, *, immutable: bool) -> sqlite3.Connection:
    """Open a database for reading; nothing in the file runs, and no value fills the memory."""
    query = "mode=ro&immutable=1" if immutable else "mode=ro"
    connection = sqlite3.connect(f"file:{quote(str(path))}?{query}", uri=True)
    try:
        connection.execute("PRAGMA trusted_schema=OFF")  # a view or a generated column of the file may call functions
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
        _add_views(connection)
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def is_still(directory: Path, path: Path) -> bool:
    """Whether a database has no writer and no log, so that a reader may take it as immutable."""
    # Without `immutable` every reader of a WAL database leaves -wal and -shm behind, beside a finished one too. With it
    # SQLite ignores a log: after kill -9 the last commits are there alone.
    return not is_held(directory) and not _size(path.with_name(f"{path.name}-wal"))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # also between two lines: the writer's last connection removes the log when it closes
        return 0


# Views in which each test and each rollout has a row of its own, also those of blocks. They are temporary: the file of
# the database, which is untrusted, has no view. What counts only, or sums up, reads the tables.

_F8, _I8 = struct.Struct("<d"), struct.Struct("<q")
_NUMBERS = "WITH RECURSIVE n(k) AS (SELECT 0 UNION ALL SELECT k + 1 FROM n WHERE k + 1 < largest_batch())"
_VIEWS = """
CREATE TEMP VIEW each_test AS
    SELECT seq, problem, test, node, x, mu, sigma, beta, F FROM tests WHERE nodes IS NULL
    UNION ALL SELECT * FROM (:numbers
        SELECT seq, problem, test + k, integer_at(nodes, k), row_at(starts, tests, k), NULL, NULL, NULL, NULL
        FROM tests JOIN n ON k < tests WHERE nodes IS NOT NULL);
CREATE TEMP VIEW each_rollout AS
    SELECT seq, problem, test, variant, replicate, seed, sha256, size, path, robustness, by_tolerance, ended,
        '' AS batch, 1 AS kept, parts
    FROM rollouts WHERE seeds IS NULL
    UNION ALL SELECT * FROM (:numbers
        SELECT seq, problem, test + k / replicates, variant, replicate + k % replicates, integer_at(seeds, k),
            lower(hex(substr(digests, 32 * k + 1, 32))), size, path, number_at(robustness_of, k),
            CASE WHEN by_tolerance_of IS NULL THEN 0 ELSE byte_at(by_tolerance_of, k) END, number_at(ended_of, k),
            sha256, CASE WHEN kept_of IS NULL THEN 1 ELSE byte_at(kept_of, k) END, NULL
        FROM rollouts JOIN n ON k < places WHERE seeds IS NOT NULL
        AND k NOT IN (SELECT json_extract(value, '$[0]') FROM json_each(failures)));
CREATE TEMP VIEW each_observation AS
    SELECT seq, problem, test, y, each, chain FROM observations WHERE y_of IS NULL
    UNION ALL SELECT * FROM (:numbers
        SELECT seq, problem, test + k, number_at(y_of, k), row_at(each_of, tests, k), chain
        FROM observations JOIN n ON k < tests WHERE y_of IS NOT NULL);
""".replace(":numbers", _NUMBERS)


def _add_views(connection: sqlite3.Connection) -> None:
    """Add the views to a connection; a block that is damaged makes their queries fail."""
    for name, function in {"number_at": _number, "integer_at": _integer, "byte_at": _byte}.items():
        connection.create_function(name, 2, function, deterministic=True)
    connection.create_function("row_at", 3, _row, deterministic=True)
    connection.create_function("largest_batch", 0, lambda: LARGEST_BATCH, deterministic=True)
    connection.executescript(_VIEWS)


def _number(column: bytes | None, place: int) -> float | None:
    if column is None:
        return None
    found: float = _F8.unpack_from(column, 8 * place)[0]
    return found if found == found else None  # noqa: PLR0124  (NaN: it has none)


def _integer(column: bytes, place: int) -> int:
    return int(_I8.unpack_from(column, 8 * place)[0])


def _byte(column: bytes, place: int) -> int:
    return column[place]


def _row(columns: bytes, rows: int, place: int) -> str:
    """Return a row of float64 numbers as JSON, as `canonical_json` writes it."""
    width = len(columns) // (8 * rows)
    return json.dumps(struct.unpack_from(f"<{width}d", columns, 8 * width * place), separators=(",", ":"))
