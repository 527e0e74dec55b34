"""The sample times that a check of a system measures: two equal stamps are a jump, and no step."""

import numpy as np

from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.check_system import _grid


def measured(*times: float) -> tuple[float, float]:
    samples = np.column_stack((times, np.zeros(len(times))))
    found = _grid(Trajectory(("t", "y"), samples), times[-1])
    return found.least_step, found.greatest_step


def test_a_jump_is_no_step() -> None:
    assert measured(0.0, 1.0, 1.0, 2.0, 3.0) == measured(0.0, 1.0, 2.0, 3.0) == (1.0, 1.0)


def test_one_sample_has_no_step() -> None:
    assert measured(0.0) == (0.0, 0.0)
