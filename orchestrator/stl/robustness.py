"""The standard quantitative semantics of STL on a sampled trajectory, vectorised over the samples.

| symbol      | name        | meaning                                        | shape  | unit             |
|-------------|-------------|------------------------------------------------|--------|------------------|
| s           | `samples`   | trajectory, one row per sample                 | (T, n) | per column       |
|             | `columns`   | names of the columns of `samples`              | (n,)   |                  |
| rho(s, t_k) | `_margins`  | robustness at every sample k                   | (T,)   | of the predicate |

a <= b and a < b give b - a; a >= b and a > b give a - b; not -rho; and min; or max; implies max(-left, right);
always the minimum, eventually the maximum over the samples from k to the last.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.stl.tree import (
    Absolute,
    Always,
    And,
    Arithmetic,
    Column,
    Comparison,
    Eventually,
    Expression,
    Formula,
    Implies,
    Negative,
    Not,
    Number,
    Or,
)

Floats = NDArray[np.float64]
Values = Floats | float  # a part without columns stays a number until a predicate spreads it over the samples

_ARITHMETIC: Mapping[str, Callable[[Values, Values], Values]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.power,
}


def robustness(tree: Formula, columns: Sequence[str], samples: Floats) -> float:
    """Return the robustness of the trajectory at its first sample, in the unit of the predicates.
    Implements eq. (robMeasure) of [ARA].

    Formula: the table at the head of this module. It is not negative if the trajectory satisfies the formula.
    `samples` has shape (T, n), T >= 1, its columns named by `columns`.

    Raises:
        ValueError: `tree` names a column that is not in `columns`, the shape does not fit, or a predicate is not
            finite at some sample (division by zero, root of a negative number, a non-finite trajectory).

    >>> from orchestrator.stl.formula import parse
    >>> robustness(parse("always (abs(phi) <= 0.75)"), ("t", "phi"), np.array([[0.0, 0.0], [0.1, -0.5]]))
    0.25

    """
    if samples.ndim != 2 or samples.shape[0] == 0 or samples.shape[1] != len(columns):
        raise ValueError(f"samples of shape {samples.shape} do not fit {len(columns)} columns")
    return float(_Evaluation(columns, samples).margins(tree)[0])


class _Evaluation:
    def __init__(self, columns: Sequence[str], samples: Floats) -> None:
        self._columns, self._samples = columns, samples

    def margins(self, tree: Formula) -> Floats:
        """Return the robustness of `tree` at every sample, shape (T,)."""
        match tree:
            case Comparison():
                return self._predicate(tree)
            case Not(operand):
                return -self.margins(operand)
            case And() | Or():
                extremum = np.minimum if isinstance(tree, And) else np.maximum
                return np.asarray(extremum(self.margins(tree.left), self.margins(tree.right)))
            case Implies(left, right):
                return np.maximum(-self.margins(left), self.margins(right))
            case Always(operand):
                return _from_here_on(np.minimum, self.margins(operand))
            case Eventually(operand):
                return _from_here_on(np.maximum, self.margins(operand))

    def _predicate(self, tree: Comparison) -> Floats:
        with np.errstate(all="ignore"):  # what is not finite is refused just below
            left, right = self._values(tree.left), self._values(tree.right)
            margin = right - left if tree.operator in {"<=", "<"} else left - right
        margins = margin if isinstance(margin, np.ndarray) else np.full(len(self._samples), margin)
        if not np.isfinite(margins).all():
            sample = int(np.flatnonzero(~np.isfinite(margins))[0])
            raise ValueError(
                f"the predicate `{tree.operator}` is {margins[sample]} at sample {sample}, not a finite number"
            )
        return margins

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


def _from_here_on(extremum: np.ufunc, margins: Floats) -> Floats:
    """Return the running extremum from the last sample back to each sample."""
    return np.asarray(extremum.accumulate(margins[::-1])[::-1], dtype=np.float64)
