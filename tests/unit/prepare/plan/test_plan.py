"""What `perfbound plan` refuses before its pilot."""

from pathlib import Path

import pytest

from perfbound.orchestrator.prepare.plan import plan
from perfbound.schemas.errors import CampaignError
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.fakes.finished import a_pair


def test_a_plan_refuses_before_its_pilot_what_a_run_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "system_spec", lambda *_: TestFunctionSystem().spec)
    hiding = a_pair("rigorous").model_copy(update={"clip": (0.0, 1.0)})
    with pytest.raises(CampaignError, match=r"c\.toml: clip: its lower end 0 hides violations"):
        plan.plan_campaign(hiding, Path("c.toml"), 1)
