"""Rollouts that end before the horizon: the last state is held, on the grid that a whole rollout has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.instants import uncovered
from perfbound.schemas.trajectory.early_end import MOST, end_of, held, missing_share, with_end
from perfbound.schemas.trajectory.trajectory import Floats, Trajectory


def of(times: Floats) -> Trajectory:
    return Trajectory(("t", "y"), np.column_stack((times, np.arange(len(times), dtype=np.float64))))


@given(
    st.sampled_from([0.1, 0.01, 1 / 240, 1 / 3, 0.25]),
    st.integers(2, 300),
    st.integers(2, 300),
)
def test_a_held_rollout_has_the_grid_of_a_whole_one(step: float, samples: int, more: int) -> None:
    whole = np.arange(samples + more + 1, dtype=np.float64) * step
    found = held(of(whole[:samples]), float(whole[-1]))
    assert found.samples[:, 0].tobytes() == whole.tobytes()
    assert (found.samples[samples:, 1] == samples - 1).all()


@pytest.mark.parametrize(
    "times",
    [
        np.zeros(1),
        np.array([0.0, 0.3]),
        np.array([0.0, 0.1, 0.1, 0.2, 0.2]),  # a jump as its last
        (np.arange(30) * 0.05).astype(np.float32).astype(np.float64),
        np.cumsum(np.full(20, 0.1)) - 0.1,
        np.array([0.0, 1e-9]),
        np.array([0.0, 0.1, 0.9, 1.9]),
    ],
)
@pytest.mark.parametrize("horizon", [3.0, 2.9999, 7.123])
def test_it_covers_the_horizon_whatever_its_steps_are(times: Floats, horizon: float) -> None:
    found = with_end(held(of(times), horizon), len(times))
    assert uncovered(found.samples[:, 0], horizon) is None
    assert len(found.samples) <= len(times) + MOST + 1
    assert end_of(found) == times[-1]
    assert missing_share(found) == pytest.approx(1.0 - times[-1] / horizon, abs=1e-3)


@pytest.mark.parametrize(("last", "horizon"), [(1.0, 1.0), (0.995, 1.0), (0.5, 0.0)])
def test_a_whole_rollout_is_left_alone(last: float, horizon: float) -> None:
    rollout = of(np.linspace(0.0, last, 101))
    assert held(rollout, horizon) is rollout
    assert end_of(with_end(rollout, 101)) is None
    assert missing_share(with_end(rollout, 101)) == 0.0
