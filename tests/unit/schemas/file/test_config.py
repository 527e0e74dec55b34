"""The campaign file of a recorded campaign."""

from pathlib import Path

import pytest

from perfbound.schemas.file.config import campaign_text
from perfbound.schemas.file.reader import load_campaign

ROOT = Path(__file__).parents[4]
FILES = sorted((*ROOT.glob("deploy/campaigns/*.toml"), ROOT / "deploy/examples/cars/cars.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_text_of_a_campaign_is_the_same_campaign(path: Path, tmp_path: Path) -> None:
    given = load_campaign(path)
    written = tmp_path / path.name
    written.write_text(campaign_text(given))
    again = load_campaign(written)
    assert again == given
    assert again.digest == given.digest
    assert len(campaign_text(given).splitlines()) < 60
