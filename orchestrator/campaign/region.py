"""The part of a box that `where` of `[space]` leaves: a condition on starts."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..mathematics.stl.condition import Truth, check_timeless, holds
from ..mathematics.stl.parser import FormulaError, parse_formula

Floats = NDArray[np.float64]
Start = tuple[float, ...]
Condition = Callable[[Sequence[Start] | Floats], Truth]
"""Whether each of some starts is in the region."""


def condition(where: str | None, parameters: Sequence[str]) -> Condition | None:
    """Return the condition on starts, whose `parameters` are in the order of the system; None where there is none.

    Raises:
        ValueError: `where` is no condition on these parameters.

    """
    if where is None:
        return None
    try:
        tree = parse_formula(where, parameters)
        check_timeless(tree)
    except FormulaError as error:
        text = str(error).replace("unknown column", "unknown parameter")
        raise ValueError(f"space.where: {text}; fix the condition") from None
    return lambda starts: holds(tree, parameters, np.array(starts, dtype=np.float64).reshape(-1, len(parameters)))
