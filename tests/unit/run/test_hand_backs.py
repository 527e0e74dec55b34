"""The line about a rollout that is handed back again and again."""

from typing import cast

import pytest

from perfbound.orchestrator.fleet.dispatch.events import OftenHandedBack
from perfbound.orchestrator.run.trust import note
from perfbound.orchestrator.store.attempts import AttemptLog
from perfbound.schemas.ids import RolloutId


@pytest.mark.parametrize(("host", "where"), [("node-1\x1b[31m", r"w on node-1\x1b[31m"), ("", "w")])
def test_it_names_the_rollout_and_the_last_worker_and_writes_nothing(host: str, where: str) -> None:
    lines: list[str] = []
    nothing = cast("AttemptLog", object())  # it would be evidence against the worker or the rollout
    note(OftenHandedBack(RolloutId("maximum", 3, "true", 0), 10, "w", host), nothing, lines.append)
    (line,) = lines
    assert line.startswith(f"maximum.3.true.0 was handed back 10 times, last by {where}: its workers are stopped ")
    assert "give them more time (--max-hours, --stop-within, the limit of the scheduler)" in line
