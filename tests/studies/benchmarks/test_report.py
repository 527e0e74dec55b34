"""The arithmetic of the benchmarks' table and of the comparison of two results."""

import json
from pathlib import Path

import pytest

from tests.studies.benchmarks import compare
from tests.studies.benchmarks.report import Row, document, table
from tests.studies.benchmarks.runs import changed

COST = Row("cost", 2.0, "ms", "peer", 10.0, ratio_at_least=8.0)
RATE = Row("rate", 30.0, "rollouts/s", "peer", 20.0)


def test_a_ratio_says_how_many_times_better_than_the_peer() -> None:
    assert COST.ratio == 5.0
    assert RATE.ratio == 1.5
    assert Row("alone", 1.0, "ms").ratio is None


def test_a_target_is_met_missed_or_open() -> None:
    assert COST.met is False
    assert Row("cost", 1.0, "ms", "peer", 10.0, ratio_at_least=8.0).met is True
    assert Row("cost", 1.0, "ms", ratio_at_least=8.0).met is None
    assert [Row("cost", value, "s", at_most=5.0).met for value in (5.0, 5.1)] == [True, False]


def test_the_table_has_a_line_a_row_under_one_head() -> None:
    head, *lines = table([COST, RATE]).splitlines()
    assert head.split() == ["measured", "value", "unit", "peer", "ratio", "target"]
    assert [line.split()[0] for line in lines] == ["cost", "rate"]
    assert lines[0].endswith("ratio >= 8: MISSED")


def _written(path: Path, *rows: Row) -> str:
    path.write_text(json.dumps(document(rows, {"commit": "c", "date": "d", "load": 0.5})))
    return str(path)


def test_compare_prints_both_and_flags_a_change_by_more_than_a_fifth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = _written(tmp_path / "old.json", COST, RATE, Row("gone", 1.0, "ms"))
    new = _written(tmp_path / "new.json", Row("cost", 2.5, "ms"), Row("rate", 33.0, "rollouts/s"))
    assert compare.main([old, new]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert lines["cost"].split()[-4:] == ["2", "2.5", "1.25", "WORSE"]
    assert lines["rate"].split()[-3:] == ["30", "33", "1.10"]
    assert "only in the old result: gone" in lines["only"]


@pytest.mark.parametrize("content", ["", "[]", '{"rows": 3}', '{"rows": [{"name": "x"}]}'])
def test_compare_refuses_another_file_in_one_line(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = _written(tmp_path / "good.json", COST), tmp_path / "bad.json"
    bad.write_text(content)
    assert compare.main([good, str(bad)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert compare.main([good, str(tmp_path / "missing.json")]) == 1
    assert "missing.json: No such file or directory" in capsys.readouterr().err


def test_only_a_key_that_stands_once_is_changed() -> None:
    assert changed("a = 1\nb = 2\n", {"b": "3"}) == "a = 1\nb = 3\n"
    with pytest.raises(ValueError, match="c occurs 0 times"):
        changed("a = 1\n", {"c": "3"})
