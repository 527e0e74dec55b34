"""Signs of life: while the rollout lasts, for each of several, never after its end, and in a forked process too."""

import _thread
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import pytest

from perfbound.workers.systems import life
from perfbound.workers.systems.base import Cancelled
from perfbound.workers.systems.life import signs_of_life
from tests.patience import PATIENCE

pytestmark = pytest.mark.integration


@pytest.fixture(autouse=True)
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(life, "TICK", 0.005)


def wait_for(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_they_count_until_the_end_and_no_further() -> None:
    steps: list[int] = []
    with signs_of_life(steps.append):
        wait_for(lambda: len(steps) >= 3)
    after = list(steps)
    other: list[int] = []
    with signs_of_life(other.append):  # the clock runs on
        wait_for(lambda: len(other) >= 3)
    assert steps == after == list(range(1, len(after) + 1))
    assert other[0] == 1


def test_a_cancelled_rollout_is_silent_and_the_other_is_not() -> None:
    cancelled: list[int] = []
    steps: list[int] = []

    def cancel(step: int) -> None:
        cancelled.append(step)
        raise Cancelled

    with signs_of_life(cancel), signs_of_life(steps.append):
        wait_for(lambda: len(steps) >= 3)
    assert cancelled == [1]


def test_a_rollout_that_raises_ends_its_signs() -> None:
    steps: list[int] = []
    with pytest.raises(ZeroDivisionError), signs_of_life(steps.append):
        raise ZeroDivisionError
    other: list[int] = []
    with signs_of_life(other.append):
        wait_for(lambda: len(other) >= 2)
    assert steps == []


def test_the_thread_ends_without_rollouts_begins_again_and_is_none_of_the_systems(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started = []
    start = _thread.start_new_thread
    monkeypatch.setattr(_thread, "start_new_thread", lambda run, arguments: started.append(start(run, arguments)))
    clock = life._Clock()
    before = threading.enumerate()
    for number in (1, 2):
        steps: list[int] = []
        rollout = clock.add(steps.append)
        wait_for(lambda steps=steps: steps)  # type: ignore[misc]
        assert threading.enumerate() == before
        clock.remove(rollout)
        wait_for(lambda: not clock._running)
        assert len(started) == number


def test_a_forked_process_gives_signs_of_its_own() -> None:
    code = """
import os, time
from perfbound.workers.systems import life
life.TICK = 0.005
steps = []
with life.signs_of_life(steps.append):
    while not steps:
        time.sleep(0.001)
    if os.fork():
        raise SystemExit(os.waitstatus_to_exitcode(os.wait()[1]))
    own = []
    with life.signs_of_life(own.append):
        while len(own) < 2:
            time.sleep(0.001)
os._exit(7)
"""
    ended = subprocess.run([sys.executable, "-W", "ignore", "-c", code], timeout=PATIENCE, check=False)
    assert ended.returncode == 7


def test_a_sleep_that_somebody_replaced_does_not_end_the_signs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock is that of the process: once it had ended so, no later rollout had a sign."""

    def refused(_seconds: float) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(time, "sleep", refused)
    came = threading.Event()
    for _ in range(2):
        came.clear()
        with signs_of_life(lambda _: came.set()):
            assert came.wait(PATIENCE)
