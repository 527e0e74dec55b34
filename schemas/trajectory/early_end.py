"""Rollouts that end before the horizon: what is made of them where the system declares `after_end`.

The last state is held to the horizon, in the step of the samples before it, and a last column, `ended`, is 0 while the
system ran and 1 where its state is held. With `after_end = "fail"` such a rollout violates the specification besides.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..instants import SAMPLES, ends_early, slack
from ..system import ENDED
from .trajectory import Trajectory

Floats = NDArray[np.float64]

MOST = 100_000
"""Samples that an early end adds, at most."""


def held(trajectory: Trajectory, horizon: float) -> Trajectory:
    """Return a trajectory that holds its last state to `horizon` s, with its own columns; itself if it does not end.

    >>> held(Trajectory(("t", "y"), np.array([[0.0, 1.0], [0.25, 2.0]])), 1.0).samples.tolist()
    [[0.0, 1.0], [0.25, 2.0], [0.5, 2.0], [0.75, 2.0], [1.0, 2.0]]
    """
    times = trajectory.samples[:, 0]
    if not ends_early(times, horizon):
        return trajectory
    later = _continued(times, horizon)
    rest = np.tile(trajectory.samples[-1], (len(later), 1))
    rest[:, 0] = later
    return replace(trajectory, samples=np.concatenate((trajectory.samples, rest)))


def with_end(trajectory: Trajectory, samples: int) -> Trajectory:
    """Return a trajectory with the column `ended`; the system itself gave its first `samples`."""
    ended = (np.arange(len(trajectory.samples)) >= samples).astype(np.float64)
    columns = (*trajectory.columns, ENDED.name)
    return replace(trajectory, columns=columns, samples=np.column_stack((trajectory.samples, ended)))


def end_of(trajectory: Trajectory) -> float | None:
    """Return when a rollout with the column `ended` ended, in s; None if it ran to the horizon."""
    ended = trajectory.column(ENDED.name) > 0.0
    return float(trajectory.samples[int(np.argmax(ended)) - 1, 0]) if ended.any() else None


def missing_share(trajectory: Trajectory) -> float:
    """Return the share of its horizon that a rollout with the column `ended` lacks.

    >>> missing_share(Trajectory(("t", "y", "ended"), np.array([[0.0, 1.0, 0.0], [0.5, 1.0, 1.0], [2.0, 1.0, 1.0]])))
    1.0
    """
    end = end_of(trajectory)
    return 0.0 if end is None else 1.0 - end / float(trajectory.samples[-1, 0])


def _continued(times: Floats, horizon: float) -> Floats:
    """Return the times at which the last state is held: those that the system would have given, and the horizon."""
    steps = np.diff(times)
    steps = steps[steps > 0.0]
    last, step = float(times[-1]), float(np.median(steps)) if len(steps) else horizon / SAMPLES
    if step < (horizon - last) / MOST:
        return np.linspace(last, horizon, MOST + 1)[1:]
    number = np.arange(1, int((horizon - last) / step) + 2, dtype=np.float64)
    later = last + number * step
    # Numbers of a step, to the last bit: rollouts of the same system then have one grid, whenever they end.
    count = np.arange(len(times), dtype=np.float64)
    for each in (float(f"{step:.6g}"), last / max(len(times) - 1, 1), 1.0 / max(round(1.0 / step), 1)):
        if len(times) > 1 and np.array_equal(times, count * each):
            later = (len(times) - 1 + number) * each
            break
    close = float(slack(times)[-1])
    later = later[later < horizon + close]
    return later if len(later) and later[-1] > horizon - close else np.append(later, horizon)
