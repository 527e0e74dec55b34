"""The margins of predicates at every sample of a trajectory, and the distance of two trajectories in them.

| symbol   | name      | meaning                                                      | shape  | unit             |
|----------|-----------|--------------------------------------------------------------|--------|------------------|
| s, z     | `samples`, `a`, `b` | trajectories, one row per sample; column 0 is the time | (T, n) | per column   |
|          | `columns` | names of the columns                                         | (n,)   |                  |
| mu_j(s)  | `margins` | right - left for <= and <, left - right for >= and >         | (T,)   | of the predicate |
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ....schemas.instants import apart, slack
from .text import excerpt
from .tree import Absolute, Arithmetic, Column, Comparison, Expression, Formula, Negative, Number, predicates

__all__ = ["Floats", "Signals", "predicate_sup"]

Floats = NDArray[np.float64]
Values = Floats | float  # a part without columns remains a number until a predicate spreads it over the samples

_ARITHMETIC: Mapping[str, Callable[[Values, Values], Values]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.power,
}


def predicate_sup(tree: Formula, columns: Sequence[str], a: Floats, b: Floats) -> float:
    """Return the distance of two trajectories in the predicates of `tree`, in their unit. It is not clipped.

    Formula: max over j of max over the samples of |mu_j(a) - mu_j(b)|; `a` and `b` have shape (T, n), T >= 1.
    |rho(a) - rho(b)| is at most this for every formula: rho is made of these margins by min, max and sign alone.
    Not in [ARA], which assumes a Lipschitz constant L of rho instead; the proof is in docs/stl.md.

    Raises:
        ValueError: the time grids (column 0) differ, or as in `robustness`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> a, b = np.array([[0.0, 1.0], [0.1, 2.0]]), np.array([[0.0, -1.5], [0.1, 1.75]])
    >>> predicate_sup(parse_formula("eventually abs(x) <= 2 and x^2 <= 9"), ("t", "x"), a, b)
    1.25

    """
    one, other = Signals(columns, a), Signals(columns, b)
    check_grids(a, b)
    return max(_margin_difference(one.margins(predicate), other.margins(predicate)) for predicate in predicates(tree))


def check_grids(a: Floats, b: Floats) -> None:
    """Check that two trajectories (T, n) can be compared sample by sample.

    Raises:
        ValueError: the time grids (column 0) differ.

    """
    if len(a) != len(b):
        raise ValueError(f"the trajectories have {len(a)} and {len(b)} samples; a gap needs one time grid")
    if np.array_equal(a[:, 0], b[:, 0]):
        return
    # One of them may have stamps of float32, or sums with their round-off.
    different = np.flatnonzero(np.abs(a[:, 0] - b[:, 0]) > np.maximum(slack(a[:, 0]), slack(b[:, 0])))
    if different.size:
        k = int(different[0])
        one, other = apart(float(a[k, 0]), float(b[k, 0]))
        raise ValueError(f"the time grids differ at sample {k}: t = {one} and {other}; a gap needs one time grid")


def _margin_difference(one: Floats, other: Floats) -> float:
    with np.errstate(over="ignore"):  # a result that is not finite raises just below
        distance = float(np.max(np.abs(one - other)))
    if not np.isfinite(distance):
        raise ValueError(f"the gap is {distance!r}, not a finite number")
    return distance


class Signals:
    """The columns of one trajectory, by name.

    Raises:
        ValueError: the shape of `samples` does not fit.

    """

    def __init__(self, columns: Sequence[str], samples: Floats) -> None:
        if samples.ndim != 2 or samples.shape[0] == 0 or samples.shape[1] != len(columns):
            raise ValueError(f"samples of shape {samples.shape} do not fit {len(columns)} columns")
        self._columns, self._samples = columns, samples

    def margins(self, predicate: Comparison) -> Floats:
        """Return mu of a predicate at every sample, shape (T,).

        Raises:
            ValueError: it names an unknown column, or is not finite at some sample.

        """
        margins = self.any_margins(predicate)
        if not np.isfinite(margins).all():
            sample = int(np.flatnonzero(~np.isfinite(margins))[0])
            raise ValueError(f"`{excerpt(predicate)}` is {margins[sample]} at sample {sample}, not a finite number")
        return margins

    def any_margins(self, predicate: Comparison) -> Floats:
        """Return mu of a predicate at every sample, shape (T,), finite or not.

        Raises:
            ValueError: it names an unknown column.

        """
        with np.errstate(all="ignore"):  # the caller checks what is not finite
            left, right = self._values(predicate.left), self._values(predicate.right)
            margin = right - left if predicate.operator in {"<=", "<"} else left - right
        return margin if isinstance(margin, np.ndarray) else np.full(len(self._samples), margin)

    def _values(self, tree: Expression) -> Values:
        match tree:
            case Number(value):
                return value
            case Column(name):
                return self._column(name)
            case Negative(operand):
                return -self._values(operand)
            case Absolute(operand):
                return np.abs(self._values(operand))
            case Arithmetic(operator, left, right):
                return _ARITHMETIC[operator](self._values(left), self._values(right))

    def _column(self, name: str) -> Floats:
        if name not in self._columns:
            raise ValueError(f"unknown column {name!r}; known are {', '.join(self._columns)}")
        return np.asarray(self._samples[:, self._columns.index(name)], dtype=np.float64)
