"""Logs that are tables: CSV, Parquet, and MAT files of MATLAB up to version 7."""

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import EvidenceError, meant, shortened
from ...schemas.file.logs import LogMapping, name_and_unit
from ...schemas.number_text import number_in
from ...schemas.outside import read_outside

Floats = NDArray[np.float64]
MAX_LOG = 2**30
"""Bytes of one log."""
TIME = "t"
"""The title of the time where the mapping gives none, and its name as a column."""
NANOSECONDS = 1e-9


def read_table(path: Path, mapping: LogMapping, units: Mapping[str, str]) -> dict[str, Floats]:
    """Return the columns (T,) of a table by the names of the system, the time as `t` if it is there.

    `units` has the unit of each column, without `t`.

    Raises:
        EvidenceError: it cannot be read, a column is missing or in another unit, or a cell is no number.

    """
    reader = READERS[path.suffix.lower()]
    wanted = {TIME: mapping.time or TIME} | {name: mapping.title(name) for name in units}
    titles, numbers = reader(path, mapping, tuple(wanted.values()))
    found = _places(path, titles, wanted, {TIME: "s", **units}, mapping)
    return {name: numbers(place, wanted[name]) for name, place in found.items()}


def _places(
    path: Path, titles: Sequence[str], wanted: Mapping[str, str], units: Mapping[str, str], mapping: LogMapping
) -> dict[str, int]:
    """Return where each column of the system is; titles may have their units in brackets."""
    names = [name_and_unit(title) for title in titles]
    found: dict[str, int] = {}
    for column, title in wanted.items():
        places = [k for k, whole in enumerate(titles) if title in (whole.strip(), names[k][0])]
        if len(places) > 1:
            raise EvidenceError(f"{path}: two columns are called {title!r}; name one under [system.logs]")
        if not places:
            if column == TIME and mapping.time is None:
                continue
            near = meant(title, [name for name, _ in names])
            other = next((sign for sign in (";", "\t", ",") if len(titles) == 1 and sign in titles[0]), None)
            if other is not None:
                near = f"give delimiter = {json.dumps(other)} under [system.logs]; "
            raise EvidenceError(
                f"{path}: there is no column {title!r}; {near}it has {shortened(', '.join(titles), 200) or 'none'}"
            )
        unit = names[places[0]][1]
        bracketed = unit if titles[places[0]].strip() != title and column not in mapping.factors else None
        if bracketed is not None and not _same_unit(bracketed, units[column]):
            raise EvidenceError(
                f"{path}: {title} is in {bracketed!r}, and the system has it in {units[column]!r}; give it in this "
                f"unit, or logs.factors.{column} under [system]"
            )
        found[column] = places[0]
    extra = [title for k, title in enumerate(titles) if k not in found.values()]
    if extra and mapping.extra == "refuse":
        raise EvidenceError(
            f"{path}: its column {extra[0].strip()[:80]!r} is none of the system; remove it, or give "
            'extra = "ignore" under [system.logs]'
        )
    return found


def _same_unit(one: str, other: str) -> bool:
    return one.strip() == other.strip() or {one.strip(), other.strip()} <= {"", "1", "-"}


Numbers = Callable[[int, str], Floats]
"""The numbers of the column in a place; its title is for messages."""


def _csv(path: Path, mapping: LogMapping, titles: Sequence[str]) -> tuple[Sequence[str], Numbers]:
    try:
        text = read_outside(path, MAX_LOG).decode("utf-8-sig")
    except OSError as error:
        raise EvidenceError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise EvidenceError(f"{path}: not UTF-8; save it as UTF-8") from None
    lines: list[int] = []
    rows: list[list[str]] = []
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=mapping.delimiter)
    try:
        for row in reader:
            if row:
                rows.append(row)
                lines.append(reader.line_num)
    except csv.Error as error:  # a cell of megabytes
        raise EvidenceError(f"{path}: not CSV: {error}; its columns are {', '.join(titles)}") from None
    if not rows:
        raise EvidenceError(f"{path}: it is empty; its columns are {', '.join(titles)}")
    head = rows.pop(0)
    for number, row in zip(lines[1:], rows, strict=True):
        if len(row) != len(head):
            other = next((sign for sign in (";", "\t") if sign in head[0]), None)
            hint = f"; give delimiter = {json.dumps(other)} under [system.logs]" if other else ""
            raise EvidenceError(f"{path}: line {number} has {len(row)} cells, and the first line {len(head)}{hint}")

    def numbers(place: int, title: str) -> Floats:
        found = np.empty(len(rows))
        for k, row in enumerate(rows):
            cell = row[place] if mapping.decimal == "." else row[place].replace(",", ".")
            try:
                found[k] = number_in(cell)
            except ValueError as error:
                hint = '; give decimal = "," under [system.logs]' if re.fullmatch(r"\s*-?\d+,\d+\s*", cell) else ""
                raise EvidenceError(f"{path}: line {lines[k + 1]}: {title}: {error}{hint}") from None
        return found

    return head, numbers


def _parquet(path: Path, mapping: LogMapping, titles: Sequence[str]) -> tuple[Sequence[str], Numbers]:  # noqa: ARG001
    from pyarrow import parquet, types  # noqa: PLC0415  (an extra)

    file = parquet.ParquetFile(path)
    head = list(file.schema_arrow.names)

    def numbers(place: int, title: str) -> Floats:
        column = file.read(columns=[head[place]]).column(0)
        if types.is_timestamp(column.type) or types.is_duration(column.type):
            per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[column.type.unit]
            stamps = column.cast("int64").to_numpy()
            return np.asarray(stamps / per_second, dtype=np.float64)
        return _floats(column.to_numpy(), path, title)

    return head, numbers


def _mat(path: Path, mapping: LogMapping, titles: Sequence[str]) -> tuple[Sequence[str], Numbers]:
    from scipy.io import loadmat  # noqa: PLC0415  (for these alone)

    try:
        found = loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise EvidenceError(f"{path}: a MAT file of version 7.3; save it with -v7, or as CSV") from None
    flat = dict(_variables({key: each for key, each in found.items() if not key.startswith("__")}, ""))
    # Of a workspace only what is named: it has whatever else was there.
    head = [name for name in flat if mapping.extra == "refuse" or name in titles]
    return head, lambda place, title: _floats(flat[head[place]], path, title)


def _variables(found: Mapping[str, Any], before: str) -> Any:
    """Yield the arrays of a workspace by their names; those of a structure with a point between."""
    for key, each in found.items():
        if hasattr(each, "_fieldnames"):
            yield from _variables({name: getattr(each, name) for name in each._fieldnames}, f"{before}{key}.")
        else:
            yield f"{before}{key}", each


def _floats(values: Any, path: Path, title: str) -> Floats:
    array = np.atleast_1d(np.asarray(values))
    if array.dtype.kind == "c":
        raise EvidenceError(f"{path}: {title} has complex numbers; give real ones")
    try:
        found = array.astype(np.float64)
    except (TypeError, ValueError):
        raise EvidenceError(f"{path}: {title} has {array.dtype} in place of numbers") from None
    if found.ndim != 1:
        raise EvidenceError(f"{path}: {title} has the shape {found.shape}; give one number a sample")
    return found


READERS: Mapping[str, Callable[[Path, LogMapping, Sequence[str]], tuple[Sequence[str], Numbers]]] = {
    ".csv": _csv,
    ".parquet": _parquet,
    ".mat": _mat,
}
"""By the end of a file's name."""
