"""A run directory that has a campaign: what the refusal of a new one advises."""

import shutil
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.run.directory import check_vacant
from perfbound.orchestrator.store.read import stored_header
from perfbound.schemas.errors import PerfboundError
from tests.facts import facts

FINISHED = Path(__file__).parents[2] / "fixtures" / "finished" / "scenario"


def test_a_finished_campaign_has_nothing_to_continue(tmp_path: Path) -> None:
    directory = Path(shutil.copytree(FINISHED, tmp_path / "run"))
    config = stored_header(directory).config
    with pytest.raises(PerfboundError, match=facts("run: `perfbound show run`")):
        check_vacant(directory, config)
    (directory / files.CERTIFICATE).unlink()
    with pytest.raises(PerfboundError, match=facts("campaign `perfbound resume")):
        check_vacant(directory, config)
