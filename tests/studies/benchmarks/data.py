"""Input of every contestant of the proposal benchmark; numpy alone, so that the peers can import it.

The paper's test function sin(z1) cos(z2)/2 on [0, 5]^2, on a lattice of 51 x 51 nodes. The kernel is Matern with
nu = 2.5, the smoothest that all peers have, l = 1 and unit amplitude; lambda = 1 on the diagonal; the acquisition
function is mu + SCALE sigma. So all but Optuna, which has its own, are asked for the same proposal.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

SIZES = (50, 385, 1000, 2000)
"""Observations before the ask + tell that is timed."""
RESOLUTION = 51
LOW, HIGH = 0.0, 5.0
NU, LENGTH_SCALE = 2.5, 1.0
REGULARISER = 1.0
SCALE = 1.0
NOISE = 0.001

Floats = NDArray[np.float64]


def lattice() -> Floats:
    """Return the candidates, shape (2601, 2); the last axis runs fastest."""
    axis = np.linspace(LOW, HIGH, RESOLUTION)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def objective(x: Floats) -> Floats:
    """Return J without noise at each row of `x`, shape (n,)."""
    return np.asarray(np.sin(x[:, 0]) * np.cos(x[:, 1]) / 2, dtype=np.float64)


def distinct(seed: int = 0) -> tuple[NDArray[Any], Floats]:
    """Return nodes and observations of as many tests as there are nodes, none twice: the dearest data there can be."""
    rng = np.random.default_rng(seed)
    nodes = rng.permutation(RESOLUTION**2)
    return nodes, objective(lattice()[nodes]) + rng.normal(0.0, NOISE, len(nodes))
