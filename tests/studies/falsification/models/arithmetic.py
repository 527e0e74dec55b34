"""Numbers in which the equations of a model are written once: floats for one rollout, arrays (R,) for many.

With arrays of one element numpy would take ten times as long as Python does with floats.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Number = Any
"""A float or an array (R,): of one rollout, or of R."""


@dataclass(frozen=True)
class Arithmetic:
    """What floats and arrays do not have in common."""

    piece: Callable[[Number, int], Number]
    """(x, last) -> the whole part of x, at least 0 and at most `last`."""
    choose: Callable[[Number, Number, Number], Number]
    """(condition, a, b) -> a where the condition holds, else b."""
    anywhere: Callable[[Number], bool]
    """Whether a condition holds in any of the rollouts."""
    constant: Callable[[float], Number]
    """A number, or R of it."""
    table: Callable[[Floats], Any]
    """A table whose elements `piece` selects."""
    series: Callable[[Floats], Any]
    """The values over time (T, R) as numbers, one for each time."""
    recorded: Callable[[Any], Floats]
    """Numbers, one for each time, as an array (R, T)."""


def _float_piece(x: float, last: int) -> int:
    whole = int(x)
    return 0 if whole < 0 else last if whole > last else whole


def _float_choose(condition: bool, a: float, b: float) -> float:
    return a if condition else b


def _piece(x: Floats, last: int) -> NDArray[np.intp]:
    return np.minimum(np.maximum(x, 0.0), last).astype(np.intp)


def arithmetic(rollouts: int) -> Arithmetic:
    """Return floats for one rollout, else arrays."""
    if rollouts == 1:
        return Arithmetic(
            _float_piece,
            _float_choose,
            anywhere=bool,
            constant=lambda value: value,
            table=np.ndarray.tolist,
            series=lambda values: values[:, 0].tolist(),
            recorded=lambda values: np.array(values, dtype=np.float64)[None],
        )
    return Arithmetic(
        _piece,
        np.where,
        anywhere=lambda condition: bool(np.any(condition)),
        constant=lambda value: np.full(rollouts, value),
        table=lambda values: values,
        series=lambda values: values,
        recorded=lambda values: np.array(values, dtype=np.float64).T,
    )
