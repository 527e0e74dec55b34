"""The margins of predicates at every sample of a trajectory, and the distance of two trajectories in them.

| symbol   | name      | meaning                                                      | shape  | unit             |
|----------|-----------|--------------------------------------------------------------|--------|------------------|
| s, z     | `samples`, `a`, `b` | trajectories, one row per sample; column 0 is the time | (T, n) | per column   |
|          | `columns` | names of the columns                                         | (n,)   |                  |
|          | `t`       | sample times of R rollouts                                   | (T,)   | s                |
|          | `values`  | their other columns: column, rollout, sample                 | (n-1, R, T) | per column  |
| mu_j(s)  | `margins` | right - left for <= and <, left - right for >= and >         | (T,)   | of the predicate |
|          |           | 1/2 - |left - right| for ==, |left - right| - 1/2 for !=     |        |                  |

Both sides of == and != are whole numbers: |left - right| is 0 where they are equal, and at least 1 where not. So the
sign of the margin is right, 0 never occurs, and one step of a column changes the margin by one.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from ....schemas.instants import apart, slack
from .text import excerpt
from .tree import (
    HALF,
    Absolute,
    Arithmetic,
    Column,
    Comparison,
    Expression,
    Formula,
    Function,
    Negative,
    Number,
    predicates,
)

__all__ = ["Floats", "Signals", "SignalsOfEach", "predicate_sup"]

Floats = NDArray[np.float64]
Values = Floats | float  # a part without columns remains a number until a predicate spreads it over the samples

_ARITHMETIC: Mapping[str, Callable[[Values, Values], Values]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.power,
}
_FUNCTIONS: Mapping[str, Callable[..., Values]] = {
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "exp": np.exp,
    "log": np.log,
}
_EXTREMES: Mapping[str, Callable[[Values, Values], Values]] = {"max": np.maximum, "min": np.minimum}


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
        self._shape = samples.shape[:1]

    def margins(self, predicate: Comparison) -> Floats:
        """Return mu of a predicate at every sample, shape (T,).

        Raises:
            ValueError: it names an unknown column, or is not finite at some sample.

        """
        margins = self.any_margins(predicate)
        if not _sound(predicate, margins).all():
            raise ValueError(_fault(predicate, margins))
        return margins

    def any_margins(self, predicate: Comparison) -> Floats:
        """Return mu of a predicate at every sample, shape (T,), finite or not; of several rollouts (R, T).

        Raises:
            ValueError: it names an unknown column.

        """
        with np.errstate(all="ignore"):  # the caller checks what is not finite
            left, right = self._values(predicate.left), self._values(predicate.right)
            match predicate.operator:
                case "<=" | "<":
                    margin = right - left
                case ">=" | ">":
                    margin = left - right
                case "==":
                    margin = HALF - np.abs(left - right)
                case "!=":
                    margin = np.abs(left - right) - HALF
        return margin if isinstance(margin, np.ndarray) else np.full(self._shape, margin)

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
            case Function("max" | "min" as name, arguments):
                return reduce(_EXTREMES[name], map(self._values, arguments))
            case Function(name, (argument,)):
                values = self._values(argument)
                # Of numbers that are apart in memory numpy may compute another last digit.
                return _FUNCTIONS[name](np.ascontiguousarray(values) if isinstance(values, np.ndarray) else values)
            case Function():
                raise AssertionError("the parser counts the arguments")

    def _column(self, name: str) -> Floats:
        return np.asarray(self._samples[:, self._index(name)], dtype=np.float64)

    def _index(self, name: str) -> int:
        if name not in self._columns:
            raise ValueError(f"unknown column {name!r}; known are {', '.join(self._columns)}")
        return self._columns.index(name)


class SignalsOfEach(Signals):
    """The columns of several rollouts on one time grid, by name; margins have the shape (R, T).

    Where a predicate is not finite, `faults` has what `Signals` raises for that rollout alone; the other rollouts keep
    their margins.

    Raises:
        ValueError: the shapes of `t` and `values` do not fit.

    """

    def __init__(self, columns: Sequence[str], t: Floats, values: Floats) -> None:
        fits = t.ndim == 1 and len(t) > 0 and values.ndim == 3
        if not (fits and values.shape[0] == len(columns) - 1 and values.shape[2] == len(t)):
            raise ValueError(f"values of shape {values.shape} at times {t.shape} do not fit {len(columns)} columns")
        self._columns, self._t, self._others = columns, t, values
        self._shape = values.shape[1:]
        self.faults: dict[int, str] = {}

    def parts(self, size: int) -> Iterator[tuple[slice, "SignalsOfEach"]]:
        """Yield at most `size` rollouts at a time: which ones, and their signals; at least once."""
        for begin in range(0, max(self._shape[0], 1), size):
            part = slice(begin, begin + size)
            yield part, SignalsOfEach(self._columns, self._t, self._others[:, part])

    def margins(self, predicate: Comparison) -> Floats:
        """Return mu of a predicate at every sample of every rollout, shape (R, T), and keep what is not finite.

        Raises:
            ValueError: it names an unknown column.

        """
        margins = self.any_margins(predicate)
        sound = _sound(predicate, margins)
        if not sound.all():
            for rollout in np.flatnonzero(~sound.all(axis=-1)).tolist():
                # The first predicate with a fault is the one that `Signals` raises.
                if rollout not in self.faults:
                    self.faults[rollout] = _fault(predicate, margins[rollout])
        return margins

    def _column(self, name: str) -> Floats:
        index = self._index(name)
        # t is spread: for x ^ t at a single sample, one exponent for all rollouts, numpy has a rule of its own.
        values = self._others[index - 1] if index else np.broadcast_to(self._t, self._shape)
        return np.ascontiguousarray(values, dtype=np.float64)


def _sound(predicate: Comparison, margins: Floats) -> NDArray[np.bool_]:
    """Return where a margin is a finite number, and of == and != one between whole numbers."""
    found = np.isfinite(margins)
    if predicate.operator in {"==", "!="}:
        with np.errstate(invalid="ignore"):  # of what is not finite
            found &= np.mod(margins + HALF, 1.0) == 0.0
    return found


def _fault(predicate: Comparison, margins: Floats) -> str:
    """Return what is wrong with margins (T,), some of which are not sound."""
    sample = int(np.flatnonzero(~_sound(predicate, margins))[0])
    if np.isfinite(margins[sample]):
        return f"`{excerpt(predicate)}` compares numbers at sample {sample} that are not whole; use <= and >="
    return f"`{excerpt(predicate)}` is {margins[sample]} at sample {sample}, not a finite number"
