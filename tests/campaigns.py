"""Campaign files for tests: the shipped ones, changed."""

import json
import tomllib
from pathlib import Path
from typing import Any

from perfbound.schemas.file.config import CampaignConfig

FOLDER = Path(__file__).parents[1] / "deploy" / "campaigns"
PAIR = Path(__file__).parent / "fixtures" / "segway-pair.toml"
"""Two problems by method `rigorous`, with the composition at each start."""
REPLICATES = 8
"""Of a cheap campaign."""


UNCHECKED: dict[str, Any] = {"spot_check": 0, "recheck": 0}
"""Most tests are about the problems alone, and shorter without the checks that follow."""


def table(name: str, **changes: Any) -> dict[str, Any]:
    """Return a shipped file, or `PAIR`, as a table, without checks afterwards, with top-level keys replaced."""
    source = PAIR if name == PAIR.stem else FOLDER / f"{name}.toml"
    return {**tomllib.loads(source.read_text()), **UNCHECKED, **changes}


def config(name: str, **changes: Any) -> CampaignConfig:
    """Return a shipped campaign, with top-level keys replaced."""
    return CampaignConfig.model_validate_json(json.dumps(table(name, **changes)))


def cheap(rollouts: int, window: int = 16) -> CampaignConfig:
    """Return the test function as a scenario campaign, whose rollouts cost nothing and whose files have 2 kB."""
    found = table("segway-scenario", horizon=0.3, specification="always (value >= -0.65)")
    found["system"] = {"name": "test-function"}
    problem = {"max_tests": rollouts // REPLICATES, "window": window, "replicates": REPLICATES, "alpha": 1e-9}
    found["problems"][0] |= problem
    return CampaignConfig.model_validate_json(json.dumps(found))


def with_few_checks(path: Path, name: str) -> Path:
    """Write a shipped campaign file with short checks after its problems, and return its path."""
    checks = "spot_check = 6\nspot_check_followups = 4\nrecheck = 3\n"
    path.write_text(checks + (FOLDER / f"{name}.toml").read_text())
    return path
