"""Method `kriging` in real campaigns: the file of the page, and a kill in between."""

from pathlib import Path

import pytest

from tests.end_to_end.processes import Ended, Processes, processes
from tests.end_to_end.report.pages import EXAMPLES, claims_after_a_kill

EXAMPLE = EXAMPLES["box.toml"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kriging")


@pytest.fixture(scope="module")
def ended(folder: Path) -> Ended:
    """The campaign of the page without trouble, in the folder `run`; it takes a third of the time of these tests."""
    with processes(folder / "logs") as started:
        return EXAMPLE.run(started, folder)


@pytest.mark.journey
def test_the_file_of_the_page_gives_the_claim_of_the_page(started: Processes, folder: Path, ended: Ended) -> None:
    EXAMPLE.check(ended)
    EXAMPLE.verify(started, folder)


@pytest.mark.usefixtures("ended")
def test_a_kill_in_between_changes_no_byte(started: Processes, folder: Path, tmp_path: Path) -> None:
    (claim,) = claims_after_a_kill(started, EXAMPLE.write(tmp_path), folder / "run", after=300)
    assert claim["method"] == "kriging"
    assert claim["refuted"] == []
