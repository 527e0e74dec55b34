"""Robustness over time: the signal that the robustness of a trajectory comes from, and the moment that decides it.

| symbol      | name       | meaning                                                          | shape | unit         |
|-------------|------------|------------------------------------------------------------------|-------|--------------|
| phi         | `formula`  | what `always` or `eventually` is about, or the whole formula     |       |              |
| rho(phi, k) | `values`   | its robustness at sample k; not a number where nothing reads it  | (T,)  | of predicate |
| C           | `deciding` | samples where a part has the value that it passes on             | (T,)  |              |

The robustness is made of predicate margins by min, max and sign alone, so it equals the margin, or its negative, of
some predicate at some sample. From the whole formula at the first sample down to the predicates, C keeps the samples
(of a minimum or maximum, those where it is attained) at which that number arises.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ....schemas.values import Beyond
from . import sliding
from .grid import Grid, Windows
from .predicates import Floats, Signals
from .robustness import margins_at_samples
from .tree import (
    STEP_BACK,
    Always,
    And,
    Comparison,
    Edge,
    Eventually,
    Formula,
    Implies,
    Not,
    Or,
    Rise,
    Since,
    Span,
    Temporal,
    Until,
    columns,
    operands,
    span,
)

__all__ = ["RobustnessSignal", "WorstMoment", "outermost", "robustness_signal", "worst_moment"]

Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Attained = Literal["least", "greatest", "first"]

MOST_PARTS = 1000
"""Parts of a formula that are followed; changes of changes have more ways down than nodes."""
MOST_PAIRS = 4_000_000
"""Pairs of samples that are compared for one `until`; of more its moment is not derived."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustnessSignal:
    """The robustness of `formula` at each sample; `attained` tells which of the values is the robustness of the whole.

    The least one for `always`, the greatest one for `eventually`, else the first one: the whole formula, evaluated at
    each sample on the rest of the trajectory.
    """

    formula: Formula
    values: Floats
    attained: Attained


@dataclass(frozen=True, slots=True)
class WorstMoment:
    """The samples `first` to `last`, without a gap, at which the robustness is attained; `columns` are read there."""

    first: int
    last: int
    columns: frozenset[str]
    predicates: frozenset[Comparison] = field(default=frozenset(), compare=False, repr=False)
    """Those that attain it."""


def robustness_signal(
    tree: Formula, names: Sequence[str], samples: Floats, beyond: Beyond = "refuse"
) -> RobustnessSignal:
    """Return the robustness of `tree`, or of what its outermost operator is about, at every sample of (T, n).

    Formula: for `always[a,b] phi` and `eventually[a,b] phi` rho(phi, k) for the samples k in [a, b]; for a conjunction
    of `always` with one interval that of the conjunction of their operands; for any other formula rho(tree, k). Where
    empty windows alone decide it has no value.

    Raises:
        FormulaError: as in `robustness`.
        ValueError: as in `robustness`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[0.0, 3.0], [1.0, 1.0], [2.0, 2.0]])
    >>> found = robustness_signal(parse_formula("always[0,1] x >= 2"), ("t", "x"), x)
    >>> found.values.tolist(), found.attained
    ([1.0, -1.0, nan], 'least')

    """
    signals, grid = Signals(names, samples), Grid(samples[:, 0], beyond)
    grid.check(tree)
    match outermost(tree):
        case Always(operand, interval) | Eventually(operand, interval) as outer:
            attained: Attained = "least" if isinstance(outer, Always) else "greatest"
            shown, read = operand, grid.windows(Span(interval)).cover(_first_sample(len(grid)))
        case _:
            shown, attained, read = tree, "first", np.ones(len(grid), dtype=np.bool_)
    values = margins_at_samples(shown, signals, grid)
    read = read & _readable(shown, grid) & np.isfinite(values)
    return RobustnessSignal(shown, np.where(read, values, np.nan), attained)


def worst_moment(tree: Formula, names: Sequence[str], samples: Floats, beyond: Beyond = "refuse") -> WorstMoment | None:
    """Return when the robustness of a trajectory (T, n) is attained; None if that is not one run of samples.

    A run of several samples is a stretch with one and the same margin, as of a vehicle that has stopped. Two
    stretches, or predicates that attain it at different times, are no moment.

    Raises:
        FormulaError: as in `robustness`.
        ValueError: as in `robustness`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[0.0, 3.0], [1.0, 1.0], [2.0, 2.0], [3.0, 1.0]])
    >>> worst_moment(parse_formula("always x >= 2 and eventually x >= 3"), ("t", "x"), x[:3])
    WorstMoment(first=1, last=1, columns=frozenset({'x'}))
    >>> worst_moment(parse_formula("always x >= 2"), ("t", "x"), x) is None
    True

    """
    found = _deciding(tree, names, samples, beyond)
    if found is None:
        return None
    rows = np.flatnonzero(found.samples)
    if rows[-1] - rows[0] + 1 != len(rows):
        return None
    read = frozenset[str]().union(*map(columns, found.predicates))
    return WorstMoment(int(rows[0]), int(rows[-1]), read, frozenset(found.predicates))


def deciding_predicates(
    tree: Formula, names: Sequence[str], samples: Floats, beyond: Beyond = "refuse"
) -> frozenset[Comparison]:
    """Return the predicates at which the robustness of a trajectory (T, n) is attained, at whatever times.

    None where that is not derived.

    Raises:
        FormulaError: as in `robustness`.
        ValueError: as in `robustness`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> x = np.array([[0.0, 3.0], [1.0, 1.0], [2.0, 1.0]])
    >>> [each.operator for each in deciding_predicates(parse_formula("always (x >= 2 and x < 9)"), ("t", "x"), x)]
    ['>=']

    """
    found = _deciding(tree, names, samples, beyond)
    return frozenset() if found is None else frozenset(found.predicates)


def _deciding(tree: Formula, names: Sequence[str], samples: Floats, beyond: Beyond) -> "_Deciding | None":
    """Return what decides the robustness of a trajectory; None where that is not derived."""
    signals, grid = Signals(names, samples), Grid(samples[:, 0], beyond)
    grid.check(tree)
    found = _Deciding(signals, grid)
    return found if found.follow(tree, _first_sample(len(grid))) else None


class _Deciding:
    """The samples at which some predicate decides the robustness, and these predicates."""

    def __init__(self, signals: Signals, grid: Grid) -> None:
        self._signals, self._grid = signals, grid
        self.samples: Flags = np.zeros(len(grid), dtype=np.bool_)
        self.predicates: set[Comparison] = set()
        self._followed = 0

    def follow(self, tree: Formula, deciding: Flags) -> bool:
        """Add what decides `tree` at the samples `deciding`, where it has one value; return whether it was derived."""
        if not deciding.any():
            return True
        self._followed += 1
        if self._followed > MOST_PARTS:
            return False
        if isinstance(tree, Comparison):
            self.samples |= deciding
            self.predicates.add(tree)
            return True
        value = self._margins(tree)[deciding][0]
        if isinstance(tree, Until | Since):
            return self._follow_until(tree, deciding, value)
        if isinstance(tree, Edge):
            return self._follow_edge(tree, deciding, value)
        if isinstance(tree, Temporal):
            deciding = self._grid.windows(span(tree)).cover(deciding)
        parts = zip(operands(tree), _signs(tree), strict=True)
        return all(self.follow(part, deciding & (sign * self._margins(part) == value)) for part, sign in parts)

    def _follow_edge(self, tree: Edge, deciding: Flags, value: float) -> bool:
        operand = self._margins(tree.operand) * (1.0 if isinstance(tree, Rise) else -1.0)
        now = deciding & (operand == value)
        before = self._grid.windows(STEP_BACK).cover(deciding) & (-operand == value)
        if value == 0.0:  # one value, and one way down
            return self.follow(tree.operand, now | before)
        return self.follow(tree.operand, now) and self.follow(tree.operand, before)

    def _follow_until(self, tree: Until | Since, deciding: Flags, value: float) -> bool:
        left, right, windows = self._margins(tree.left), self._margins(tree.right), self._grid.windows(span(tree))
        if int(deciding.sum()) * len(left) > MOST_PAIRS:
            return False
        if isinstance(tree, Since):
            backwards = _deciding_until((left[::-1], right[::-1]), windows.mirrored, deciding[::-1], value)
            of_left, of_right = (each[::-1] for each in backwards)
        else:
            begin = windows.first if tree.reading == "paper" else None
            of_left, of_right = _deciding_until((left, right), windows, deciding, value, begin)
        return self.follow(tree.left, of_left) and self.follow(tree.right, of_right)

    def _margins(self, tree: Formula) -> Floats:
        return margins_at_samples(tree, self._signals, self._grid)


def _deciding_until(
    sides: tuple[Floats, Floats], windows: Windows, deciding: Flags, value: float, begins: Indices | None = None
) -> tuple[Flags, Flags]:
    """Return the samples at which each side of an until has the `value` that it has at the samples `deciding`.

    The left side is read from `begins` on, by default from now on.
    """
    left, right = sides
    of_left, of_right = np.zeros_like(deciding), np.zeros_like(deciding)
    for k in np.flatnonzero(deciding).tolist():
        # Of a jump the window may have the sample before it, too.
        begin = min(k, int(windows.first[k])) if begins is None else int(begins[k])
        ends = slice(int(windows.first[k]), int(windows.stop[k]))
        least = np.minimum.accumulate(left[begin : ends.stop])[ends.start - begin :]
        best = np.flatnonzero(np.minimum(least, right[ends]) == value) + ends.start
        of_right[best[right[best] == value]] = True
        # Left decides up to the last of the ends that attain the value, where its minimum is that value.
        last = best[least[best - ends.start] == value]
        if last.size:
            run = np.arange(begin, int(last[-1]) + 1)
            of_left[run[left[run] == value]] = True
    return of_left, of_right


def _signs(tree: Formula) -> tuple[int, ...]:
    """Return for each operand whether its margin enters as it is, or negated."""
    match tree:
        case Not():
            return (-1,)
        case Implies():
            return (-1, 1)
        case _:
            return (1,) * len(operands(tree))


def outermost(tree: Formula) -> Formula:
    """Return the formula with `always` or `eventually` outermost where an equal one has it."""
    match tree:
        case Not(operand):
            match outermost(operand):
                case Always(inner, interval):
                    return Eventually(_negated(inner), interval)
                case Eventually(inner, interval):
                    return Always(_negated(inner), interval)
        case And(left, right):
            match outermost(left), outermost(right):
                case Always(one, interval), Always(other, also) if interval == also:
                    return Always(And(one, other), interval)
        case Or(left, right):
            match outermost(left), outermost(right):
                case Eventually(one, interval), Eventually(other, also) if interval == also:
                    return Eventually(Or(one, other), interval)
    return tree


def _negated(tree: Formula) -> Formula:
    return tree.operand if isinstance(tree, Not) else Not(tree)


def _readable(tree: Formula, grid: Grid) -> Flags:
    """Return where `tree` can be read: its intervals contain a sample, and end before the trajectory does."""
    found: Flags = np.ones(len(grid), dtype=np.bool_)
    if isinstance(tree, Edge):
        operand = _readable(tree.operand, grid)
        return operand & _throughout(operand, grid.windows(STEP_BACK))
    if isinstance(tree, Temporal):
        of = span(tree)
        found = (~grid.windows(of).empty | grid.outside(of)) & grid.reaches(of)
        for part, windows in zip(operands(tree), grid.windows_of(tree), strict=True):
            found = found & _throughout(_readable(part, grid), windows)
        return found
    for part in operands(tree):
        found = found & _readable(part, grid)
    return found


def _throughout(flags: Flags, windows: Windows) -> Flags:
    """Return whether `flags` hold in the whole window of each sample, as they do in an empty one."""
    found: Flags = sliding.minimum(flags.astype(np.float64), windows) >= 1.0
    return found


def _first_sample(samples: int) -> Flags:
    found: Flags = np.arange(samples) == 0
    return found
