"""A finished campaign of each method, as this perfbound's rules and formats have it: it is read by every command."""

import json
import shutil
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, contents

pytestmark = pytest.mark.smoke
FINISHED = Path(__file__).parents[2] / "fixtures" / "finished"
METHODS = ("paper", "rigorous", "kriging", "scenario", "sample")
CHECKS = 20


@pytest.mark.journey
@pytest.mark.parametrize("name", METHODS)
def test_a_finished_campaign_verifies(started: Processes, name: str) -> None:
    directory = Path(shutil.copytree(FINISHED / name, started.folder / name))
    before = contents(directory)
    ended = started.run("perfbound", "verify", directory, "--json")
    found = {each["check"]: each["status"] for each in json.loads(ended.out)["checks"]}
    assert "failed" not in found.values()
    assert ended.code == 0
    assert len(found) >= CHECKS
    for command in ("status", "show", "resume"):
        ended = started.run("perfbound", command, directory)
        assert ended.code == 0, ended.err
        assert "CLAIM  " in ended.out
    assert contents(directory) == before
    for command in ("export", "report"):
        assert started.run("perfbound", command, directory).code == 0
