"""The margins of predicates at every sample of a trajectory, and the distance of two trajectories in them.

| symbol   | name      | meaning                                                      | shape  | unit             |
|----------|-----------|--------------------------------------------------------------|--------|------------------|
| s, z     | `samples`, `a`, `b` | trajectories, one row per sample; column 0 is the time | (T, n) | per column   |
|          | `columns` | names of the columns                                         | (n,)   |                  |
|          | `t`       | sample times of R rollouts                                   | (T,)   | s                |
|          | `values`  | their other columns: column, rollout, sample                 | (n-1, R, T) | per column  |
| mu_j(s)  | `margins` | right - left for <= and <, left - right for >= and >         | (T,)   | of the predicate |
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ....schemas.instants import apart, slack
from .text import excerpt
from .tree import Absolute, Arithmetic, Column, Comparison, Expression, Formula, Negative, Number, predicates

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
        if not np.isfinite(margins).all():
            raise ValueError(_not_finite(predicate, margins))
        return margins

    def any_margins(self, predicate: Comparison) -> Floats:
        """Return mu of a predicate at every sample, shape (T,), finite or not; of several rollouts (R, T).

        Raises:
            ValueError: it names an unknown column.

        """
        with np.errstate(all="ignore"):  # the caller checks what is not finite
            left, right = self._values(predicate.left), self._values(predicate.right)
            margin = right - left if predicate.operator in {"<=", "<"} else left - right
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
        if not np.isfinite(margins).all():
            for rollout in np.flatnonzero(~np.isfinite(margins).all(axis=-1)).tolist():
                # The first predicate that is not finite is the one that `Signals` raises.
                if rollout not in self.faults:
                    self.faults[rollout] = _not_finite(predicate, margins[rollout])
        return margins

    def _column(self, name: str) -> Floats:
        index = self._index(name)
        # t is spread: for x ^ t at a single sample, one exponent for all rollouts, numpy has a rule of its own.
        values = self._others[index - 1] if index else np.broadcast_to(self._t, self._shape)
        return np.ascontiguousarray(values, dtype=np.float64)


def _not_finite(predicate: Comparison, margins: Floats) -> str:
    """Return what is wrong with margins (T,), some of which are not finite."""
    sample = int(np.flatnonzero(~np.isfinite(margins))[0])
    return f"`{excerpt(predicate)}` is {margins[sample]} at sample {sample}, not a finite number"
