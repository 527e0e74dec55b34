"""The time of a child before its first step, which is that of loading, and after it."""

import subprocess
import time
from typing import Any, cast

import pytest

from perfbound.orchestrator.fleet.children import child


class Silent:
    """A child that never ends, on a clock of its own."""

    def __init__(self) -> None:
        self.now = 0.0

    def communicate(self, timeout: float) -> Any:
        self.now += timeout
        raise subprocess.TimeoutExpired("child", timeout)


@pytest.mark.parametrize(("loaded_at", "ended_at"), [(30.0, 32.0), (1e9, 60.0)])
def test_to_load_a_system_may_take_longer_than_a_rollout(
    monkeypatch: pytest.MonkeyPatch, loaded_at: float, ended_at: float
) -> None:
    silent = Silent()
    monkeypatch.setattr(time, "monotonic", lambda: silent.now)
    with pytest.raises(subprocess.TimeoutExpired):
        child._printed(cast(Any, silent), 60.0, 2.0, lambda: int(silent.now >= loaded_at))
    assert silent.now == ended_at
