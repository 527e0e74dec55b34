"""Time grids that are known."""

import numpy as np
from numpy.typing import NDArray

from perfbound.orchestrator.run import results
from perfbound.orchestrator.run.results import Grids
from perfbound.schemas.ids import RolloutId


def rollout(test: int) -> RolloutId:
    return RolloutId("p", test, "nominal", 0)


def sampled(*times: float) -> NDArray[np.float64]:
    return np.array(times, dtype=np.float64)


def test_a_grid_is_known_once_two_workers_have_sent_it() -> None:
    found = Grids()
    sent = [found.is_known(sampled(0, 1), worker, rollout(test)) for test, worker in enumerate("aaba")]
    assert sent == [False, False, True, True]
    assert not found.is_known(sampled(0, 1, 2), "b", rollout(9))


def test_a_grid_is_known_once_a_repetition_has_it() -> None:
    found = Grids()
    assert [found.is_known(sampled(0, 1), "a", rollout(test)) for test in (0, 1, 2)] == [False, False, False]
    assert [found.is_known(sampled(0, 2), "a", rollout(test)) for test in (2, 2, 3)] == [False, True, True]


def test_the_grid_of_a_recorded_rollout_is_known() -> None:
    found = Grids()
    found.take(sampled(0, 1))
    assert found.is_known(sampled(0, 1), "a", rollout(0))


def test_the_oldest_grids_are_forgotten() -> None:
    found = Grids()
    found.take(sampled(0, 1))
    for number in range(results.MOST):
        assert not found.is_known(sampled(0, 2 + number), "a", rollout(number))
        assert found.is_known(sampled(0, 1), "a", rollout(0)), "one that is in use"
    assert not found.is_known(sampled(0, 2), "b", rollout(0))


def test_a_system_with_grids_of_its_own_for_its_starts_is_recognised() -> None:
    found = Grids()
    for number in range(results.VARIOUS):
        assert not found.vary
        found.take(sampled(0, 1 + number))
    assert found.vary
