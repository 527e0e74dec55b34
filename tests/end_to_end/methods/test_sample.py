"""Starts that are drawn, and several requirements: the files of the page, a crash on the way, the check."""

from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes
from tests.end_to_end.report.pages import EXAMPLES, claims_after_a_kill


@pytest.mark.parametrize("name", ["requirements.toml", "each.toml"])
def test_the_file_of_the_page_on_requirements_gives_its_claims(started: Processes, tmp_path: Path, name: str) -> None:
    example = EXAMPLES[name]
    example.check(example.run(started, tmp_path))
    example.verify(started, tmp_path)


def test_a_kill_in_between_changes_no_byte(started: Processes, tmp_path: Path) -> None:
    example = EXAMPLES["often.toml"]
    example.check(example.run(started, tmp_path))
    example.verify(started, tmp_path)
    claims = claims_after_a_kill(started, example.write(tmp_path), tmp_path / "run", after=30)
    assert [each["quantity"] for each in claims] == ["failure_probability", "quantile", "cvar"]
