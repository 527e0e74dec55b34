"""Tables with named columns."""

import sys

import numpy as np
import pytest

from perfbound.library.tables import SHOWN, Table
from perfbound.orchestrator.store.export_tables import ExportColumn
from perfbound.schemas.errors import PerfboundError

COLUMNS = (ExportColumn("id", "text"), ExportColumn("test", "integer"), ExportColumn("y", unit="m"))
TABLE = Table.of(COLUMNS, [("a", 0, 1.5), ("<b>", 1, None), (None, 2, -0.5)])


def test_a_column_is_an_array_and_a_row_has_names() -> None:
    assert len(TABLE) == 3
    assert TABLE.columns == ("id", "test", "y")
    assert (TABLE["test"].dtype.name, TABLE["y"].dtype.name) == ("int64", "float64")
    assert np.isnan(TABLE["y"][1])
    assert [row.id for row in TABLE] == ["a", "<b>", None]
    assert (TABLE.rows[2].test, TABLE.rows[2].y, TABLE.units["y"]) == (2, -0.5, "m")
    with pytest.raises(KeyError, match="no column 'z'; there are id, test, y"):
        TABLE["z"]


def test_a_whole_number_that_is_missing_is_nan() -> None:
    found = Table.of(COLUMNS[1:2], [(1,), (None,)])["test"]
    assert found[0] == 1
    assert np.isnan(found[1])


def test_rows_are_chosen() -> None:
    assert TABLE.only(TABLE["test"] > 0)["id"].tolist() == ["<b>", None]
    assert len(TABLE.only(TABLE["test"] > 5)) == 0


def test_without_rows_and_with_names_of_python() -> None:
    empty = Table.of(COLUMNS, [])
    assert (len(empty), empty.rows, empty._repr_html_().count("<tr>")) == (0, (), 1)
    assert Table.of((ExportColumn("class"), ExportColumn("y")), [(1.0, 2.0)]).rows[0].y == 2


def test_html_is_escaped_and_short() -> None:
    html = TABLE._repr_html_()
    assert "&lt;b&gt;" in html
    assert "<b>" not in html
    assert "y (m)" in html
    many = Table.of(COLUMNS, [("a", k, 0.0) for k in range(100)])
    assert many._repr_html_().count("<tr>") == SHOWN + 1
    assert "100 rows" in many._repr_html_()


def test_pandas_is_not_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(PerfboundError, match="pandas is not installed"):
        TABLE.to_pandas()
