"""The noise of a rollout, from several rollouts at a start.

| symbol | name     | meaning                                                               | shape  | unit   |
|--------|----------|-----------------------------------------------------------------------|--------|--------|
| x      | `values` | J of k rollouts at each start, with different seeds                   | (n, k) | unit J |
| s_i    |          | standard deviation at one start                                       | (n,)   | unit J |
| s      | `pooled` | root of the mean of s_i^2                                             | ()     | unit J |
| R      | `scale`  | sub-Gaussian scale that is proposed for one rollout                   | ()     | unit J |
"""

import math

import numpy as np
from numpy.typing import NDArray

from ..gp.kernels import Floats, squared_distances

NOISIEST = 4
"""Starts at which more rollouts follow."""
POOLED = 6
"""Starts whose spread ranks a start: two rollouts at one alone rank by chance."""
FALLS = 10.0
"""Standard deviations of the neighbours by which a rollout deviates from its start only where rare falls do it."""
MARGIN = 1.5
"""R over the largest standard deviation at the noisiest starts: theirs are estimates, and others may be noisier."""


def pooled(values: Floats) -> float:
    """Return the pooled standard deviation of one rollout (n, k), in its unit; 0 for single rollouts.

    >>> pooled(np.array([[0.0, 2.0], [5.0, 5.0]]))
    1.0
    """
    return math.sqrt(float(values.var(axis=1, ddof=1).mean())) if values.shape[1] > 1 else 0.0


def nearest_starts(shares: Floats) -> NDArray[np.intp]:
    """Return for each start (n, p) the `POOLED` nearest ones, itself among them, (n, POOLED)."""
    return np.argsort(squared_distances(shares, shares), axis=1, kind="stable")[:, :POOLED]


def noisiest(shares: Floats, values: Floats, count: int = NOISIEST) -> list[int]:
    """Return the starts (n, p) where rollouts (n, k) spread most, each ranked together with its nearest ones."""
    variances = values.var(axis=1, ddof=1)
    near = nearest_starts(shares)
    ranks = variances[near].mean(axis=1)
    order = np.argsort(-ranks, kind="stable")
    chosen: list[int] = []
    for start in order.tolist():
        # Neighbours share most of their rank; rollouts at another place show more.
        if not any(start in near[other] for other in chosen):
            chosen.append(start)
        if len(chosen) == count:
            break
    return chosen


def largest_deviation(shares: Floats, values: Floats) -> float:
    """Return the largest deviation of a rollout (n, k) from the mean of its start (n, p), in standard deviations.

    The standard deviation is that of the rollouts at the nearest other starts, and at least a quarter of the pooled
    one, so that noise which differs from start to start is no large deviation; 0 without noise.
    """
    spread = pooled(values)
    if not spread > 0:
        return 0.0
    variances = values.var(axis=1, ddof=1)
    near = variances[nearest_starts(shares)[:, 1:]].mean(axis=1)
    deviations = np.abs(values - values.mean(axis=1, keepdims=True)).max(axis=1)
    k = values.shape[1]
    return float(np.max(deviations / np.sqrt(np.maximum(near, (spread / 4) ** 2) * (k - 1) / k)))


def noise_scale(values: Floats, at_noisiest: Floats) -> float:
    """Return R of one rollout: a margin over the largest spread at the noisiest starts (m, k), and over the pooled one.

    The rollouts at the noisiest starts are others than those that chose them: their spread is not biased by the choice.

    >>> noise_scale(np.array([[0.0, 1.0]]), np.array([[0.0, 2.0, 1.0]]))
    1.5
    """
    largest = float(at_noisiest.std(axis=1, ddof=1).max()) if at_noisiest.size else 0.0
    return MARGIN * max(largest, pooled(values))
