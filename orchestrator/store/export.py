"""A campaign's tables as CSV or Parquet files from one snapshot, also while the campaign runs."""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

from sqlalchemy import Connection

from ...schemas.atomic import make_folder, replacing
from ...schemas.errors import PerfboundError, meant
from ...schemas.result.facts import Header
from . import export_tables
from .export_tables import TABLES, ExportColumn, ExportTable, Row, Value
from .files import FOLDER
from .read import read_header, reading
from .rows import DATABASE

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "TABLES",
    "counterexamples",
    "csv_rows",
    "export",
    "stream",
    "table_array",
    "table_rows",
    "text_of_cell",
    "whole",
]

Format = Literal["csv", "parquet"]
DEFAULT = "export"
"""Folder in the run directory."""
GROUP = 10_000
"""Rows of a Parquet row group, and between two reports of progress."""

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""First characters that make a cell a formula for a spreadsheet."""

Progress = Callable[[str, int], None]
"""Called with a table's name and the number of its rows so far."""


def export(
    directory: Path,
    folder: Path,
    names: Sequence[str] = TABLES,
    *,
    form: Format = "csv",
    progress: Progress = lambda _name, _rows: None,
) -> list[tuple[Path, int]]:
    """Write tables of the campaign in `directory` into `folder`, all of them or none; return (file, rows) of each.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.
        PerfboundError: an unknown table, pyarrow is missing, or `folder` is not to be written, or cannot be.

    """
    paths = [folder / f"{name}.{form}" for name in names]
    write = _writer(form)
    with _open_campaign(directory, names) as (connection, header, found), whole(directory, paths) as files:
        return [
            (path, write(file, table, _counted(table, connection, progress), header))
            for path, file, table in zip(paths, files, found, strict=True)
        ]


def stream(directory: Path, name: str, out: IO[bytes]) -> int:
    """Write one table as CSV to `out`; return its rows. Raises as `export`, and OSError if `out` is closed."""
    with _open_campaign(directory, [name]) as (connection, header, (table,)):
        return _csv(out, table, table.rows(connection), header)


def table_rows(directory: Path, name: str) -> tuple[tuple[ExportColumn, ...], list[Row]]:
    """Return the columns of one table, and all its rows. Raises as `export`."""
    with _open_campaign(directory, [name]) as (connection, _, (table,)):
        return table.columns, list(table.rows(connection))


def table_array(directory: Path, name: str) -> "NDArray[Any]":
    """Return one table as an array (rows,) with a field for each column. Raises as `export`.

    A missing number is NaN, a missing text None; a column of whole numbers that lacks one is float64. The title of a
    field is the column's in a CSV file, with its unit: `array["x (m)"]` is `array["x"]`.
    """
    import numpy as np  # noqa: PLC0415  (late: `perfbound export` writes files without it)

    columns, found = table_rows(directory, name)
    types = {"text": "O", "integer": "i8", "number": "f8"}
    lack = {
        k for k, each in enumerate(columns) if each.kind == "integer" and any(values[k] is None for values in found)
    }
    fields: Any = {
        "names": [each.name for each in columns],
        "formats": ["f8" if k in lack else types[each.kind] for k, each in enumerate(columns)],
        "titles": [_column_title(each) if each.unit else None for each in columns],
    }
    row: np.dtype[Any] = np.dtype(fields)
    return np.array(found, dtype=row)


def counterexamples(directory: Path, path: Path) -> int:
    """Write the rollouts with robustness below 0 as CSV to `path`; return how many. Raises as `export`."""
    opened = _open_campaign(directory, ["counterexamples"])
    with opened as (connection, header, (table,)), whole(directory, [path]) as (file,):
        return _csv(file, table, table.rows(connection), header)


@contextmanager
def _open_campaign(directory: Path, names: Sequence[str]) -> Iterator[tuple[Connection, Header, list[ExportTable]]]:
    """Open a campaign at one moment, with the named tables."""
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        near, allowed = meant(unknown[0], TABLES), ", ".join(TABLES)
        raise PerfboundError(f"there is no table {unknown[0]!r}; {near}allowed are {allowed}")
    with reading(directory) as connection:
        header = read_header(connection, directory)
        yield connection, header, [export_tables.export_table(name, header) for name in names]


def _counted(table: ExportTable, connection: Connection, progress: Progress) -> Iterator[Row]:
    for number, row in enumerate(table.rows(connection)):
        if number % GROUP == 0:
            progress(table.name, number)
        yield row


# Formats


def _writer(form: Format) -> Callable[[IO[bytes], ExportTable, Iterable[Row], Header], int]:
    if form == "csv":
        return _csv
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415  (an extra, and slow to load)
    except ImportError:
        raise PerfboundError("Parquet needs pyarrow: pip install 'perfbound[parquet]', or use --format csv") from None
    return _parquet


def _csv(out: IO[bytes], table: ExportTable, found: Iterable[Row], _header: Header) -> int:
    return csv_rows(out, table.columns, found)


def csv_rows(out: IO[bytes], columns: Iterable[ExportColumn], found: Iterable[Row]) -> int:
    """Write RFC 4180: UTF-8, CRLF, floats that read back exactly, nothing for NULL; units are in the first line.

    Return the number of rows.
    """
    text = io.TextIOWrapper(out, encoding="utf-8", newline="")
    try:
        writer, number = csv.writer(text), 0
        writer.writerow(map(_column_title, columns))
        for number, row in enumerate(found, 1):  # noqa: B007
            writer.writerow(map(_cell, row))
        text.flush()
    finally:
        text.detach()
    return number


def _column_title(column: ExportColumn) -> str:
    return f"{column.name} ({column.unit})" if column.unit else column.name


def _cell(value: Value) -> Value:
    """Return the content of the cell: an untrusted text (a worker's name) must not become a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def text_of_cell(cell: str) -> str:
    """Return the text that `csv_rows` has made a cell of.

    >>> text_of_cell("'-x >= 0"), text_of_cell("x >= 0")
    ('-x >= 0', 'x >= 0')
    """
    return cell[1:] if cell.startswith("'") and cell[1:].startswith(FORMULA) else cell


def _parquet(out: IO[bytes], table: ExportTable, found: Iterable[Row], header: Header) -> int:
    """Write Parquet; the unit of a column is its field's metadata `unit`."""
    import pyarrow as pa  # noqa: PLC0415
    from pyarrow.parquet import ParquetWriter  # noqa: PLC0415

    types = {"text": pa.string(), "integer": pa.int64(), "number": pa.float64()}
    fields = [pa.field(each.name, types[each.kind], metadata=_metadata(unit=each.unit)) for each in table.columns]
    about = _metadata(campaign=header.config.name, run=header.run, config_sha256=header.config_sha256)
    schema, total, left = pa.schema(fields, metadata=about), 0, iter(found)
    with ParquetWriter(out, schema) as writer:
        while group := list(islice(left, GROUP)):
            columns = zip(*group, strict=True)
            arrays = [pa.array(values, field.type) for values, field in zip(columns, schema, strict=True)]
            writer.write_batch(pa.record_batch(arrays, schema=schema))
            total += len(group)
    return total


def _metadata(**entries: str) -> dict[str, str] | None:
    return {key: value for key, value in entries.items() if value} or None


# Files


@contextmanager
def whole(directory: Path, paths: Sequence[Path]) -> Iterator[list[IO[bytes]]]:
    """Open files that are in their places together at the end of the block, or leave nothing after an error.

    Raises:
        PerfboundError: they are among the evidence of the campaign in `directory`, or cannot be written.

    """
    try:
        for path in paths:
            _check_place(directory, path)
            make_folder(path.parent)
        with replacing(paths) as files:
            yield files
    except OSError as error:
        where = error.filename2 or error.filename or paths[0].parent
        raise PerfboundError(f"{where}: cannot be written ({error.strerror or error}); choose another --out") from None


def _check_place(directory: Path, path: Path) -> None:
    """Refuse to write among the evidence or over the database."""
    place, run = path.resolve(), directory.resolve()
    if run / FOLDER in (place, *place.parents):
        raise PerfboundError(f"{path}: {FOLDER} is for evidence alone; choose another --out")
    if place.parent == run and place.name.startswith(DATABASE):
        raise PerfboundError(f"{path}: this is the campaign's database; choose another --out")
