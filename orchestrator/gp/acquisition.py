"""Choosing the next point: the maximiser of an acquisition function on the lattice."""

import numpy as np

from orchestrator.gp.kernels import Floats

TIE = 1e-12
"""Values this close to the maximum count as equal, so that round-off never decides a proposal."""


def maximiser(values: Floats) -> int:
    """Return the lowest index whose value is within `TIE` of the maximum.

    Raises:
        ValueError: `values` is empty or holds a NaN.

    >>> maximiser(np.array([0.5, 1.0, 1.0 + 1e-13]))
    1

    """
    if values.size == 0:
        raise ValueError("no values to maximise over")
    top = values.max()
    if np.isnan(top):
        raise ValueError("the acquisition function is NaN at a node")
    return int(np.argmax(values >= top - TIE))
