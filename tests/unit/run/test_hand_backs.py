"""The line about a rollout that is handed back again and again."""

from typing import cast

import pytest

from perfbound.orchestrator.fleet.dispatch.events import OftenHandedBack
from perfbound.orchestrator.run.trust import note
from perfbound.orchestrator.store.attempts import AttemptLog
from perfbound.schemas.ids import RolloutId
from tests.facts import says


@pytest.mark.parametrize(("host", "where"), [("node-1\x1b[31m", r"w on node-1\x1b[31m"), ("", "w")])
def test_it_names_the_rollout_and_the_last_worker_and_writes_nothing(host: str, where: str) -> None:
    lines: list[str] = []
    nothing = cast("AttemptLog", object())  # it would be evidence against the worker or the rollout
    note(OftenHandedBack(RolloutId("maximum", 3, "true", 0), 10, "w", host), nothing, lines.append)
    (line,) = lines
    assert says(line, f"^maximum.3.true.0 10 times {where}:")
    assert says(line, "more --max-hours --stop-within")
