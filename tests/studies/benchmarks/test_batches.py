"""The arithmetic of the benchmark of batches, and its function."""

import numpy as np
import pytest

from tests.studies.benchmarks import cheap
from tests.studies.benchmarks.parts.batches import rates_of

LOOKS = [(0.0, {1: 2.0}), (10.0, {1: 3.0, 7: 0.5, 8: 0.0}), (20.0, {1: 5.0, 7: 4.5, 8: 2.0}), (30.0, {1: 9.0})]
"""The orchestrator is process 1; 7 and 8 are workers, which have ended at the last look."""


def test_rates_are_those_between_the_first_and_the_last_result() -> None:
    rates = rates_of([(10.0, 256), (12.0, 256), (20.0, 144)], LOOKS, 1, {7, 8})
    assert rates.per_second == 40.0
    assert rates.orchestrator == pytest.approx(2.0 / 400 * 1e6)
    assert rates.workers == pytest.approx(6.0 / 400 * 1e6)
    assert rates.cpu == rates.orchestrator + rates.workers


def test_cpu_times_are_interpolated_between_two_looks() -> None:
    assert rates_of([(5.0, 1), (15.0, 10)], LOOKS, 1, {7}).orchestrator == pytest.approx(1.5 / 10 * 1e6)


def test_a_rollout_of_the_function_follows_from_its_own_start_and_seed() -> None:
    a, b, seeds = np.array([0.1, 0.9, 0.4]), np.array([0.2, 0.3, 0.7]), np.array([5, 2**53 - 1, 0], dtype=np.uint64)
    together = cheap.simulated(a, b, seeds, 100)
    for place in range(3):
        one = slice(place, place + 1)
        alone = cheap.simulated(a[one], b[one], seeds[one], 100)
        assert all(np.array_equal(together[name][place], alone[name][0]) for name in cheap.COLUMNS)
    assert np.unique(together["w"]).size == 300


def test_a_batch_has_the_samples_of_four_columns() -> None:
    values, content = cheap.a_batch(3, 16, 100)
    assert values.shape == (16,)
    assert len(content) == 16 * 3200
    assert content != cheap.a_batch(4, 16, 100)[1]
