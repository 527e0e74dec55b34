"""A function that simulates many rollouts in microseconds each, for the benchmark of batches; it needs NumPy alone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
COLUMNS = ("w", "x", "y", "z")
STEP = 0.05
LIMIT = 5.0
"""The specification is that x stays below it."""
_GOLDEN, _FIRST, _SECOND = (np.uint64(each) for each in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def simulated(a: Floats, b: Floats, seeds: NDArray[Any], samples: int) -> dict[str, Floats]:
    """Return each column as (rollouts, samples); a rollout follows from its own start and seed."""
    t, noise = np.arange(samples) * STEP, _noise(seeds, samples)
    x = a[:, np.newaxis] + 0.1 * noise + 0.1 * t
    return {"w": noise, "x": x, "y": x * b[:, np.newaxis], "z": x - b[:, np.newaxis]}


def _noise(seeds: NDArray[Any], samples: int) -> Floats:
    """Return uniform numbers: SplitMix64 of the seed of each rollout, which needs no generator for each of them."""
    state = seeds.astype(np.uint64)[:, np.newaxis] + _GOLDEN * np.arange(1, samples + 1, dtype=np.uint64)
    state = (state ^ (state >> np.uint64(30))) * _FIRST
    state = (state ^ (state >> np.uint64(27))) * _SECOND
    state = (state ^ (state >> np.uint64(31))) >> np.uint64(11)
    return np.asarray(state / 2.0**53)


def robustness(columns: dict[str, Floats]) -> Floats:
    """Return the robustness of each rollout."""
    return np.asarray(LIMIT - columns["x"].max(axis=1))


def a_batch(number: int, batch: int, samples: int) -> tuple[Floats, bytes]:
    """Simulate the batch of this number; return the robustness of each rollout, and the bytes of all samples."""
    seeds = np.arange(number * batch, (number + 1) * batch, dtype=np.uint64)
    a, b = np.random.default_rng(number).random((2, batch))
    columns = simulated(a, b, seeds, samples)
    return robustness(columns), np.stack([columns[name] for name in COLUMNS], axis=-1).tobytes()
