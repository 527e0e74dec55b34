"""Campaigns that are played without waiting for the disk."""

from collections.abc import Iterator

import pytest

from perfbound.orchestrator.run import service


@pytest.fixture(scope="module")
def no_disk() -> Iterator[None]:
    """Have nothing wait for the disk; what is durable is not the question here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        patch.setattr(service, "TICK", 0.01)
        yield
