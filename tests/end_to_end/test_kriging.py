"""Method `kriging` in real campaigns: the page and its file, and a kill in between."""

from pathlib import Path

from tests.end_to_end.pages import PAGES, check_claim, claims_after_a_kill, write
from tests.end_to_end.processes import Processes

PAGE = (PAGES / "kriging.md").read_text()


def test_the_file_of_the_page_gives_the_claim_of_the_page(started: Processes, tmp_path: Path) -> None:
    check_claim(started, tmp_path, PAGE)


def test_a_kill_in_between_changes_no_byte(started: Processes, tmp_path: Path) -> None:
    (claim,) = claims_after_a_kill(started, write(tmp_path, PAGE), after=300)
    assert claim["method"] == "kriging"
    assert claim["refuted"] == []
