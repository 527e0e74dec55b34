"""Quantitative semantics of STL on sampled trajectories, vectorised over the samples, and over rollouts on one grid.

| symbol      | name      | meaning                                                             | shape  | unit        |
|-------------|-----------|---------------------------------------------------------------------|--------|-------------|
| s           | `samples` | trajectory, one row per sample; column 0 is the time t              | (T, n) | per column  |
|             | `columns` | names of the columns of `samples`                                   | (n,)   |             |
|             | `t`       | sample times of R rollouts                                          | (T,)   | s           |
|             | `values`  | their other columns: column, rollout, sample              | (n-1, R, T)      | per column  |
| W_k         | `windows` | samples i with t_k + a <= t_i <= t_k + b, or to the end; see `grid` | (T,)   |             |
| rho(s, t_k) | `margins` | robustness at every sample k                              | (T,) or (R, T)   | predicate's |

a <= b and a < b give b - a; a >= b and a > b give a - b; not -rho; and min; or max; implies max(-left, right);
always the minimum, eventually the maximum over W_k; until, in both readings, the maximum over i in W_k of
min(rho_right(i), min of rho_left(j) over k <= j <= i); in the reading of [ARA] j begins with W_k instead of k.
historically, once and since are always, eventually and until of the trajectory backwards in time; next and previous the
value at the sample beside k; rise min(-rho(k - 1), rho(k)), and fall that of the negation. Over no sample a minimum is
inf, and a maximum -inf, as it is for next and previous: which windows may be empty depends on the sample times alone.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....schemas.values import Beyond
from . import sliding
from .errors import FormulaError
from .grid import Grid, OtherReading, Windows
from .predicates import Floats, Signals, SignalsOfEach
from .tree import (
    REST,
    STEP_BACK,
    Always,
    And,
    Comparison,
    Eventually,
    Fall,
    Formula,
    Historically,
    Implies,
    Next,
    Not,
    Once,
    Or,
    Previous,
    Rise,
    Since,
    Span,
    Temporal,
    Timed,
    Until,
    span,
    walk,
)

__all__ = ["Evaluated", "EvaluatedEach", "evaluated", "evaluated_each", "margins_at_samples", "robustness"]

Flags = NDArray[np.bool_]

AT_ONCE = 2**15
"""Values of one column that `evaluated_each` reads at once: its arrays of 256 KiB then stay in the cache of a core."""


def robustness(tree: Formula, columns: Sequence[str], samples: Floats, beyond: Beyond = "refuse") -> float:
    """Return the robustness of the trajectory at its first sample, in the unit of the predicates.
    Implements eq. (robMeasure) of [ARA].

    Formula: the lines at the head of this module. rho > 0: the trajectory satisfies the formula; rho < 0: it does not.
    `samples` has shape (T, n), T >= 1, its columns named by `columns`, the first one the time in s. With `beyond` =
    "truncate" windows are cut at the last sample.
    Deviation: [ARA] has "satisfied if and only if rho >= 0"; at 0 no min/max robustness decides (x < 0 and
    not x > 0 have the same one).

    Raises:
        FormulaError: `tree` reaches beyond the last sample, an interval contains no sample where it is read, or empty
            windows alone decide.
        ValueError: `tree` names a column that is not in `columns`, the shape does not fit, a predicate is not
            finite at some sample (division by zero, root of a negative number, a non-finite trajectory), or the
            formula has intervals and the sample times do not increase.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> trajectory = np.array([[0.0, 0.0], [0.5, -0.5], [1.0, 0.75]])
    >>> robustness(parse_formula("always (abs(phi) <= 1)"), ("t", "phi"), trajectory)
    0.25
    >>> robustness(parse_formula("always[0,0.5] abs(phi) <= 1"), ("t", "phi"), trajectory)
    0.5

    """
    signals, grid = Signals(columns, samples), Grid(samples[:, 0], beyond)
    grid.check(tree)
    return float(_decided(margins_at_samples(tree, signals, grid)[0]))


class Evaluated(NamedTuple):
    """The robustness of a trajectory, and whether the tolerance around its time stamps could decide its sign."""

    robustness: float
    by_tolerance: bool


def evaluated(tree: Formula, columns: Sequence[str], samples: Floats, beyond: Beyond = "refuse") -> Evaluated:
    """Return the robustness, as `robustness` does, and whether the tolerance of `schemas.instants` could decide its
    sign.

    Formula: with each border of a window on either side of the stamps within its tolerance, rho is between rho_low,
    which takes its minima over the widest windows and its maxima over the narrowest, and rho_high, which does the
    opposite. Their signs differ.

    Raises:
        As `robustness`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[0.0, 1.0], [0.1, 1.0], [0.2, 1.0], [0.3, -1.0]])
    >>> float32 = np.column_stack([x[:, 0].astype(np.float32), x[:, 1]])
    >>> [evaluated(parse_formula("always[0,0.3] x >= 0"), ("t", "x"), each) for each in (x, float32)]
    [Evaluated(robustness=-1.0, by_tolerance=False), Evaluated(robustness=-1.0, by_tolerance=True)]

    """
    signals, (grid, *others) = Signals(columns, samples), _grids(samples[:, 0], beyond)
    grid.check(tree)
    value = float(_decided(margins_at_samples(tree, signals, grid)[0]))
    differ = _differ(tree, grid, others)
    return Evaluated(value, by_tolerance=differ and bool(_signs_differ(tree, signals, others)))


class EvaluatedEach(NamedTuple):
    """What `evaluated` returns for each of R rollouts, by their index: its two parts, or the message of its error.

    A rollout that is in `faults` has the robustness nan.
    """

    robustness: Floats  # (R,)
    by_tolerance: Flags  # (R,)
    faults: dict[int, str]


def evaluated_each(
    tree: Formula, columns: Sequence[str], t: Floats, values: Floats, beyond: Beyond = "refuse"
) -> EvaluatedEach:
    """Return what `evaluated` returns for each of R rollouts that share one time grid, to the bit.

    `t` has shape (T,), T >= 1; `values` (n - 1, R, T) has the columns after the time: column, rollout, sample. Samples
    that are next to one another in memory are fastest.

    Raises:
        As `evaluated`, but for a predicate that is not finite, or compares numbers that are not whole: `faults` has the
        message of each such rollout.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[[1.0, 0.5], [2.0, 0.0], [4.0, 2.0]]])
    >>> found = evaluated_each(parse_formula("always 1 / x <= 3"), ("t", "x"), np.array([0.0, 0.1]), x)
    >>> found.robustness.tolist(), found.by_tolerance.tolist()
    ([1.0, nan, 2.5], [False, False, False])
    >>> found.faults
    {1: '`1 / x <= 3` is -inf at sample 1, not a finite number'}

    """
    signals, (grid, *others) = SignalsOfEach(columns, t, values), _grids(t, beyond)
    grid.check(tree)
    differ = _differ(tree, grid, others)
    rollouts = values.shape[1]
    found = EvaluatedEach(np.empty(rollouts), np.zeros(rollouts, dtype=np.bool_), {})
    for part, those in signals.parts(max(AT_ONCE // len(t), 1)):
        found.robustness[part] = margins_at_samples(tree, those, grid)[..., 0]
        if differ:
            found.by_tolerance[part] = _signs_differ(tree, those, others)
        found.faults.update((part.start + rollout, those.faults[rollout]) for rollout in sorted(those.faults))
    without = list(found.faults)
    found.robustness[without], found.by_tolerance[without] = np.nan, False
    _decided(found.robustness)
    return found


def _decided(values: Floats) -> Floats:
    """Return robustness of trajectories, which their values decide.

    Raises:
        FormulaError: empty windows alone do, of this formula and these sample times.

    """
    if np.isinf(values).any():
        word = "true" if np.nanmax(values) > 0 else "false"
        raise FormulaError(
            f"the formula is {word} of every trajectory: what decides it has no sample before the start or beyond the "
            "end; begin later, or shorten its interval"
        )
    return values


def _grids(times: Floats, beyond: Beyond) -> tuple[Grid, OtherReading, OtherReading]:
    """Return the grid of sample times (T,), its widest and its narrowest reading, with the windows found so far."""
    return _known_grids(np.asarray(times, dtype=np.float64).tobytes(), beyond)


@lru_cache(maxsize=4)  # most rollouts of a system have one grid
def _known_grids(times: bytes, beyond: Beyond) -> tuple[Grid, OtherReading, OtherReading]:
    grid = Grid(np.frombuffer(times), beyond)
    return grid, OtherReading(grid, wide=True), OtherReading(grid, wide=False)


def _differ(tree: Formula, grid: Grid, others: Sequence[Grid]) -> bool:
    """Whether some window of `tree` has other samples in another reading."""
    spans = {span(node) for node in walk(tree) if isinstance(node, Timed) and node.interval != REST}
    return not all(grid.windows(each).are(other.windows(each)) for each in spans for other in others)


def _signs_differ(tree: Formula, signals: Signals, others: Sequence[Grid]) -> Flags:
    """Return whether rho_low and rho_high of `evaluated` have different signs, shape () or (R,)."""
    wide, narrow = others
    low, high = _Reader(signals, ((wide, narrow), (narrow, wide))).margins(tree)
    return np.asarray(np.sign(low[..., 0]) != np.sign(high[..., 0]))


def margins_at_samples(tree: Formula, signals: Signals, grid: Grid) -> Floats:
    """Return the robustness of `tree` at every sample, shape (T,); where `tree` is not read it has no meaning.

    Of the signals of R rollouts the shape is (R, T).
    """
    (found,) = _Reader(signals, ((grid, grid),)).margins(tree)
    return found


class _Reader:
    """The margins of formulas in one reading of the windows, or in two of which each is the other's under a negation.

    A reading has the grid of its minima and that of its maxima.
    """

    def __init__(self, signals: Signals, readings: tuple[tuple[Grid, Grid], ...]) -> None:
        self._signals, self._readings = signals, readings

    def margins(self, tree: Formula) -> tuple[Floats, ...]:
        """Return the robustness of `tree` at every sample in each reading."""
        match tree:
            case Comparison():
                return (self._signals.margins(tree),) * len(self._readings)
            case Not(operand):
                return _negated(self.margins(operand))
            case And(left, right):
                return _each(np.minimum, self.margins(left), self.margins(right))
            case Or(left, right):
                return _each(np.maximum, self.margins(left), self.margins(right))
            case Implies(left, right):
                return _each(np.maximum, _negated(self.margins(left)), self.margins(right))
            case _:
                return self._over_time(tree)

    def _over_time(self, tree: Temporal) -> tuple[Floats, ...]:
        match tree:
            case Always(operand) | Historically(operand):
                return self._minimum(self.margins(operand), span(tree))
            case Eventually(operand) | Once(operand) | Next(operand) | Previous(operand):
                return self._maximum(self.margins(operand), span(tree))
            case Until(left, right) | Since(left, right):
                sides = zip(self.margins(left), self.margins(right), self._readings, strict=True)
                return tuple(_until(tree, one, other, maxima.windows(span(tree))) for one, other, (_, maxima) in sides)
            case Rise(operand):
                return self._change(self.margins(operand))
            case Fall(operand):
                return self._change(_negated(self.margins(operand)))

    def _change(self, now: tuple[Floats, ...]) -> tuple[Floats, ...]:
        return _each(np.minimum, self._maximum(_negated(now), STEP_BACK), now)

    def _minimum(self, values: tuple[Floats, ...], of: Span) -> tuple[Floats, ...]:
        grids = (minima for minima, _ in self._readings)
        return tuple(sliding.minimum(each, grid.windows(of)) for each, grid in zip(values, grids, strict=True))

    def _maximum(self, values: tuple[Floats, ...], of: Span) -> tuple[Floats, ...]:
        grids = (maxima for _, maxima in self._readings)
        return tuple(sliding.maximum(each, grid.windows(of)) for each, grid in zip(values, grids, strict=True))


def _negated(values: tuple[Floats, ...]) -> tuple[Floats, ...]:
    return tuple(-each for each in reversed(values))


def _each(of: np.ufunc, left: tuple[Floats, ...], right: tuple[Floats, ...]) -> tuple[Floats, ...]:
    return tuple(of(one, other) for one, other in zip(left, right, strict=True))


def _until(tree: Until | Since, left: Floats, right: Floats, windows: Windows) -> Floats:
    if isinstance(tree, Since):
        return _from_now(left[..., ::-1], right[..., ::-1], windows.mirrored)[..., ::-1]
    return _from_now(left, right, windows) if tree.reading == "standard" else sliding.until(left, right, windows)


def _from_now(left: Floats, right: Floats, windows: Windows) -> Floats:
    # min(left from now to i) = min(left from now to the window's first sample, left from there to i).
    return np.minimum(sliding.minimum(left, windows.up_to_first), sliding.until(left, right, windows))
