"""Campaign files for tests: the shipped ones, changed."""

import json
import tomllib
from pathlib import Path
from typing import Any

from perfbound.schemas.campaign import CampaignConfig

FOLDER = Path(__file__).parents[1] / "deploy" / "campaigns"


def table(name: str, **changes: Any) -> dict[str, Any]:
    """Return a shipped campaign file as a table, with top-level keys replaced."""
    return {**tomllib.loads((FOLDER / f"{name}.toml").read_text()), **changes}


def config(name: str, **changes: Any) -> CampaignConfig:
    """Return a shipped campaign, with top-level keys replaced."""
    return CampaignConfig.model_validate_json(json.dumps(table(name, **changes)))
