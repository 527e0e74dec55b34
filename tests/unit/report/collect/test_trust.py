"""The pauses of workers: each begin counts, and the early end of one does not."""

from types import SimpleNamespace
from typing import Any

from perfbound.orchestrator.report.collect.trust import TrustStatistics
from perfbound.orchestrator.store.changes import PauseChange


def changes(*seconds: float) -> Any:
    pauses = [PauseChange("worker", "w-1", float(at), each, "it broke") for at, each in enumerate(seconds)]
    return SimpleNamespace(opinions=(), pauses=pauses)


def test_the_early_end_of_a_pause_is_no_pause() -> None:
    found = TrustStatistics()
    found.add(changes(30.0, 0.0, 60.0))
    ((_, pauses),) = found._pauses.items()
    assert pauses.times == 2
    assert not pauses.for_good
    found.add(changes(float("inf")))
    assert next(iter(found._pauses.values())).for_good
