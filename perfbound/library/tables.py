"""Tables with named columns: what notebooks and scripts read of a campaign, without pandas."""

import html
from collections import namedtuple
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..schemas.errors import PerfboundError

if TYPE_CHECKING:
    from ..orchestrator.store.export_tables import ExportColumn, Value

SHOWN = 10
"""Rows of a table in a notebook."""


@dataclass(frozen=True, eq=False)
class Table:
    """Rows with named columns: `table["y"]` is an array (N,), iteration yields rows, `table.rows[3].y` is a value.

    `units` has the unit of each column, "" where it has none. Numbers are float64 with NaN for a missing one, whole
    numbers int64 where none is missing, texts objects with None for a missing one.
    """

    data: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]

    @classmethod
    def of(cls, columns: Sequence["ExportColumn"], rows: Sequence[Sequence["Value"]]) -> "Table":
        """Return the table of rows that were read from a campaign."""
        data = {each.name: _column_values([row[k] for row in rows], each.kind) for k, each in enumerate(columns)}
        return cls(data, {each.name: each.unit for each in columns})

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self.data)

    @property
    def rows(self) -> tuple[Any, ...]:
        """The rows as named tuples."""
        row = namedtuple("Row", self.columns, rename=True)  # type: ignore[misc]
        return tuple(map(row._make, zip(*(values.tolist() for values in self.data.values()), strict=True)))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.data.values()), ()))

    def __iter__(self) -> Iterator[Any]:
        """Iterate over the rows."""
        return iter(self.rows)

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Return a column, shape (N,).

        Raises:
            KeyError: there is none of this name.

        """
        if column not in self.data:
            raise KeyError(f"no column {column!r}; there are {', '.join(self.data)}")
        return self.data[column]

    def only(self, rows: NDArray[np.bool_]) -> "Table":
        """Return the table of some rows: `table.only(table["y"] < 0)`; `rows` has the shape (N,)."""
        return Table({name: values[rows] for name, values in self.data.items()}, self.units)

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame of the same columns.

        Raises:
            PerfboundError: pandas is not installed.

        """
        try:
            import pandas as pd  # type: ignore[import-untyped,import-not-found,unused-ignore]  # noqa: PLC0415
        except ImportError:
            raise PerfboundError("to_pandas: pandas is not installed; install it, or use the columns") from None
        return pd.DataFrame(dict(self.data))

    def __repr__(self) -> str:
        """Return the number of rows, and the names of the columns."""
        return f"<Table of {len(self)} rows: {', '.join(self.columns)}>"

    def _repr_html_(self) -> str:
        """Return the first rows as HTML; every text is escaped, because systems and workers choose some of them."""
        titles = "".join(f"<th>{html.escape(_with_unit(name, self.units[name]))}</th>" for name in self.data)
        rows = zip(*(values[:SHOWN].tolist() for values in self.data.values()), strict=True)
        body = "".join(
            f"<tr>{''.join(f'<td>{html.escape(_cell_text(each))}</td>' for each in row)}</tr>" for row in rows
        )
        more = f"<p>{len(self)} rows</p>" if len(self) > SHOWN else ""
        return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>{more}"


def _column_values(values: Sequence["Value"], kind: str) -> NDArray[Any]:
    if kind == "text":
        return np.array(values, dtype=object)
    if kind == "integer" and None not in values:
        return np.array(values, dtype=np.int64)
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _with_unit(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _cell_text(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.6g}"
    return "" if value is None else str(value)[:40]
