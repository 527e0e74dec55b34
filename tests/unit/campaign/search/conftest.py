"""Campaigns of this folder are small: nothing waits for the disk or the clock."""

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.run import service


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)
    with threadpool_limits(1):
        yield
