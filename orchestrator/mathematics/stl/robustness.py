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
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import sliding
from .grid import Grid, StrictGrid
from .predicates import Floats, Signals, SignalsOfEach
from .tree import REST, Always, And, Comparison, Eventually, Formula, Implies, Not, Or, Temporal, Until, walk

__all__ = ["Evaluated", "EvaluatedEach", "evaluated", "evaluated_each", "margins_at_samples", "robustness"]

Flags = NDArray[np.bool_]

AT_ONCE = 2**15
"""Values of one column that `evaluated_each` reads at once: its arrays of 256 KiB then stay in the cache of a core."""


def robustness(tree: Formula, columns: Sequence[str], samples: Floats) -> float:
    """Return the robustness of the trajectory at its first sample, in the unit of the predicates.
    Implements eq. (robMeasure) of [ARA].

    Formula: the lines at the head of this module. rho > 0: the trajectory satisfies the formula; rho < 0: it does not.
    `samples` has shape (T, n), T >= 1, its columns named by `columns`, the first one the time in s.
    Deviation: [ARA] has "satisfied if and only if rho >= 0"; at 0 no min/max robustness decides (x < 0 and
    not x > 0 have the same one).

    Raises:
        FormulaError: `tree` reaches beyond the last sample, or an interval contains no sample where it is read.
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
    signals, grid = Signals(columns, samples), Grid(samples[:, 0])
    grid.check(tree)
    return float(margins_at_samples(tree, signals, grid)[0])


class Evaluated(NamedTuple):
    """The robustness of a trajectory, and whether the tolerance around its time stamps could decide its sign."""

    robustness: float
    by_tolerance: bool


def evaluated(tree: Formula, columns: Sequence[str], samples: Floats) -> Evaluated:
    """Return the robustness, as `robustness` does, and whether the tolerance of `schemas.instants` could decide its
    sign.

    Formula: with each border of a window on either side of the stamps within its tolerance, rho is between rho_low,
    which takes its minima over all of them and its maxima over none, and rho_high, which does the opposite. Their
    signs differ.

    Raises:
        As `robustness`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[0.0, 1.0], [0.1, 1.0], [0.2, 1.0], [0.3, -1.0]])
    >>> float32 = np.column_stack([x[:, 0].astype(np.float32), x[:, 1]])
    >>> [evaluated(parse_formula("always[0,0.3] x >= 0"), ("t", "x"), each) for each in (x, float32)]
    [Evaluated(robustness=-1.0, by_tolerance=False), Evaluated(robustness=-1.0, by_tolerance=True)]

    """
    signals, (grid, strictly) = Signals(columns, samples), _grids(samples[:, 0])
    grid.check(tree)
    value = float(margins_at_samples(tree, signals, grid)[0])
    strict = _other_reading(tree, grid, strictly)
    return Evaluated(value, by_tolerance=strict is not None and bool(_signs_differ(tree, signals, grid, strict)))


class EvaluatedEach(NamedTuple):
    """What `evaluated` returns for each of R rollouts, by their index: its two parts, or the message of its error.

    A rollout that is in `faults` has the robustness nan.
    """

    robustness: Floats  # (R,)
    by_tolerance: Flags  # (R,)
    faults: dict[int, str]


def evaluated_each(tree: Formula, columns: Sequence[str], t: Floats, values: Floats) -> EvaluatedEach:
    """Return what `evaluated` returns for each of R rollouts that share one time grid, to the bit.

    `t` has shape (T,), T >= 1; `values` (n - 1, R, T) has the columns after the time: column, rollout, sample. Samples
    that are next to one another in memory are fastest.

    Raises:
        As `evaluated`, but for a predicate that is not finite: `faults` has the message of each such rollout.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[[1.0, 0.5], [2.0, 0.0], [4.0, 2.0]]])
    >>> found = evaluated_each(parse_formula("always 1 / x <= 3"), ("t", "x"), np.array([0.0, 0.1]), x)
    >>> found.robustness.tolist(), found.by_tolerance.tolist()
    ([1.0, nan, 2.5], [False, False, False])
    >>> found.faults
    {1: '`1 / x <= 3` is -inf at sample 1, not a finite number'}

    """
    signals, (grid, strictly) = SignalsOfEach(columns, t, values), _grids(t)
    grid.check(tree)
    strict = _other_reading(tree, grid, strictly)
    rollouts = values.shape[1]
    found = EvaluatedEach(np.empty(rollouts), np.zeros(rollouts, dtype=np.bool_), {})
    for part, those in signals.parts(max(AT_ONCE // len(t), 1)):
        found.robustness[part] = margins_at_samples(tree, those, grid)[..., 0]
        if strict is not None:
            found.by_tolerance[part] = _signs_differ(tree, those, grid, strict)
        found.faults.update((part.start + rollout, those.faults[rollout]) for rollout in sorted(those.faults))
    without = list(found.faults)
    found.robustness[without], found.by_tolerance[without] = np.nan, False
    return found


def _grids(times: Floats) -> tuple[Grid, StrictGrid]:
    """Return the grid of sample times (T,), and the one without tolerance, with the windows that were found so far."""
    return _known_grids(np.asarray(times, dtype=np.float64).tobytes())


@lru_cache(maxsize=4)  # most rollouts of a system have one grid
def _known_grids(times: bytes) -> tuple[Grid, StrictGrid]:
    grid = Grid(np.frombuffer(times))
    return grid, StrictGrid(grid)


def _other_reading(tree: Formula, grid: Grid, strict: StrictGrid) -> StrictGrid | None:
    """Return the grid without tolerance, if some window of `tree` has other samples there."""
    intervals = {node.interval for node in walk(tree) if isinstance(node, Temporal)} - {REST}
    return None if all(grid.windows(each).are(strict.windows(each)) for each in intervals) else strict


def _signs_differ(tree: Formula, signals: Signals, grid: Grid, strict: StrictGrid) -> Flags:
    """Return whether rho_low and rho_high of `evaluated` have different signs, shape () or (R,)."""
    low, high = (margins_at_samples(tree, signals, *grids)[..., 0] for grids in ((grid, strict), (strict, grid)))
    return np.asarray(np.sign(low) != np.sign(high))


def margins_at_samples(tree: Formula, signals: Signals, grid: Grid, maxima: Grid | None = None) -> Floats:
    """Return the robustness of `tree` at every sample, shape (T,); where `tree` is not read it has no meaning.

    Of the signals of R rollouts the shape is (R, T). With `maxima` maxima are over its windows, and minima over those
    of `grid`.
    """
    maxima = maxima or grid
    match tree:
        case Comparison():
            return signals.margins(tree)
        case Not(operand):
            return -margins_at_samples(operand, signals, maxima, grid)
        case And(left, right):
            return np.minimum(*(margins_at_samples(each, signals, grid, maxima) for each in (left, right)))
        case Or(left, right):
            return np.maximum(*(margins_at_samples(each, signals, grid, maxima) for each in (left, right)))
        case Implies(left, right):
            negated = -margins_at_samples(left, signals, maxima, grid)
            return np.maximum(negated, margins_at_samples(right, signals, grid, maxima))
        case Always(operand, interval):
            return sliding.minimum(margins_at_samples(operand, signals, grid, maxima), grid.windows(interval))
        case Eventually(operand, interval):
            return sliding.maximum(margins_at_samples(operand, signals, grid, maxima), maxima.windows(interval))
        case Until():
            return _until(tree, signals, grid, maxima)


def _until(tree: Until, signals: Signals, grid: Grid, maxima: Grid) -> Floats:
    left, right = (margins_at_samples(each, signals, grid, maxima) for each in (tree.left, tree.right))
    windows = maxima.windows(tree.interval)
    from_start = sliding.until(left, right, windows)
    if tree.reading == "paper":
        return from_start
    # min(left from now to i) = min(left from now to the window's first sample, left from there to i).
    return np.minimum(sliding.minimum(left, windows.up_to_first()), from_start)
