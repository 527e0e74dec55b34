"""From the parameters of a search to a rollout: the input signals at the steps of a model, and one rollout of many."""

from collections.abc import Callable

import numpy as np

from tests.studies.falsification.benchmark import Floats, Rollout

ROUND_OFF = 1e-9
"""In s, so that a step at the end of an interval belongs to the next one."""


def steps(duration: float, step: float) -> Floats:
    """Return the times (T,) of a model in s, from 0 to `duration`."""
    return step * np.arange(round(duration / step) + 1, dtype=np.float64)


def held(values: Floats, every: float, times: Floats) -> Floats:
    """Return signals (..., T) that hold each value (..., k) for `every` seconds, and the last one after that.

    >>> held(np.array([[1.0, 2.0]]), 5.0, np.array([0.0, 4.9, 5.0, 10.0])).tolist()
    [[1.0, 1.0, 2.0, 2.0]]
    """
    interval = ((times + ROUND_OFF) / every).astype(np.intp)
    signals: Floats = values[..., np.minimum(interval, values.shape[-1] - 1)]
    return signals


def linear(values: Floats, until: float, times: Floats) -> Floats:
    """Return signals (..., T), linear between the values (..., k) at evenly spaced times from 0 to `until`.

    >>> linear(np.array([[1.0, 2.0]]), 10.0, np.array([0.0, 5.0, 10.0])).tolist()
    [[1.0, 1.5, 2.0]]
    """
    place = np.clip(times / until, 0.0, 1.0) * (values.shape[-1] - 1)
    left = np.minimum(place.astype(np.intp), values.shape[-1] - 2)
    signals: Floats = values[..., left] + (place - left) * (values[..., left + 1] - values[..., left])
    return signals


def one(simulate_each: Callable[[Floats], Rollout], point: Floats) -> Rollout:
    """Return the rollout of one point (p,)."""
    times, columns = simulate_each(point[None])
    return times, {name: values[0] for name, values in columns.items()}
