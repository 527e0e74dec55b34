"""The campaign file of a recorded campaign."""

from pathlib import Path

import pytest

from perfbound.schemas.file.config import DECIDES_NOTHING, CampaignConfig, campaign_text
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


DECIDE = {
    *(
        "anytime",
        "batch",
        "beyond",
        "candidates",
        "claims",
        "clip",
        "composition",
        "control",
        "disturbances",
        "draws",
        "falsify",
        "gap",
        "horizon",
    ),
    *(
        "max_tests",
        "name",
        "on_refuted",
        "problems",
        "recheck",
        "regions",
        "recorded",
        "replicates",
        "resolution",
        "risk_weight",
        "seed",
        "space",
    ),
    *("specification", "specifications", "spot_check", "spot_check_followups", "spot_replicates", "system"),
    *("until_counterexample", "where", "window"),
}
"""Keys that decide a number of a campaign: they belong to its identity, and every seed follows from that."""


def test_of_every_key_it_is_known_whether_it_decides_a_number() -> None:
    found = CampaignConfig.model_fields.keys()
    assert found - DECIDE == DECIDES_NOTHING, "a new key that changes no number belongs to DECIDES_NOTHING, else here"
