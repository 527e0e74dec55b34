"""The wealth of the bets of a spot check, see `spot_check`."""

import math
from collections.abc import Sequence

import numpy as np

from ..rounding import RICHEST

DEFICITS = (0.25, 0.5, 1.0, 2.0)
"""Each strategy bets what is best (Kelly, second order) for this mean excess, in standard deviations of a rollout."""


class SpotWealth:
    """The wealth of one kind of bets: own ones of every start, and the joint one of follow-ups."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._own = np.full((len(DEFICITS), size), 1.0 / len(DEFICITS))  # (S, m)
        self._joint = np.full(len(DEFICITS), 1.0 / len(DEFICITS))  # (S,)

    def bet(self, node: int, factors: Sequence[float], *, joins: bool) -> None:
        """Multiply the wealth of every strategy at a start, and of follow-ups if this is one that `joins` them."""
        # As numbers of Python: one that overflows is infinite, and not a warning.
        for s, factor in enumerate(factors):
            self._own[s, node] = min(float(self._own[s, node]) * factor, RICHEST)
            self._joint[s] = min(float(self._joint[s]) * factor, RICHEST) if joins else self._joint[s]

    def own(self, node: int) -> float:
        """W_j of a start."""
        return math.fsum(self._own[:, node])

    @property
    def whole(self) -> float:
        """W."""
        # Half each: the mean over the starts names one that is bad, the joint bets show many that are a little too bad.
        return (math.fsum(self._own.ravel()) / self._size + math.fsum(self._joint)) / 2.0
