"""Curves of rollouts: the quantities of a problem, their limits, and their values, thinned.

A quantity is a column, or an expression that the specification compares, such as `y2 - y1`; its text is its name.
"""

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ....schemas.file.problem_models import Problem
from ....schemas.result.facts import Header
from ....schemas.trajectory.input_signal import InputSignal, start_values
from ....schemas.trajectory.trajectory import Trajectory
from ...mathematics.stl.parser import FormulaError, parse_formula
from ...mathematics.stl.predicates import Signals
from ...mathematics.stl.text import text
from ...mathematics.stl.tree import (
    Absolute,
    Arithmetic,
    Column,
    Comparison,
    Expression,
    Formula,
    Negative,
    Number,
    columns,
    predicates,
)
from ...mathematics.stl.units import unit_of
from ..data.rollouts import Curve, InputCurve

Floats = NDArray[np.float64]

MOST_POINTS = 240
"""Points of one curve."""
INPUT_POINTS = 101
"""Of an input signal, beside its knots."""
PER_PERIOD, MOST_INPUT_POINTS = 16, 1000
"""Further ones of a sine."""
MOST_KNOTS = 100
"""Knots of one input that are marked."""
MOST_QUANTITIES = 3
"""Quantities drawn for one test."""
MOST_FURTHER = 40
"""Further columns of a test, which a reader may ask for."""
FURTHER_POINTS = 120
"""Points of a curve of theirs."""


def formula(header: Header) -> Formula | None:
    """Return the specification; None if there is none, or if its grammar is that of another version."""
    text = header.config.formula
    try:
        return None if text is None else parse_formula(text, header.spec.units)
    except FormulaError:
        return None


def relevant_quantities(header: Header, problem: Problem, deciding: Collection[str] = ()) -> tuple[str, ...]:
    """Return the quantities that a problem's objective reads: those `deciding`, other expressions, then columns."""
    gap = header.config.gap_of(problem)
    column = problem.column or (None if gap is None else gap.column)
    tree = formula(header)
    if column is not None or tree is None:
        return () if column is None else (column,)
    compared = [quantity(predicate) for predicate in predicates(tree)]
    read, own = columns(tree), [each.name for each in header.spec.columns]
    # The time against the time shows nothing.
    wanted = [name for name in own[1:] if name in read] or own[:1]
    first = [name for name in compared if name in deciding and name != own[0]]
    expressions = [name for name in compared if name not in own]
    return tuple(dict.fromkeys([*first, *expressions, *wanted]))[:MOST_QUANTITIES]


def further_columns(header: Header, shown: Sequence[str]) -> tuple[str, ...]:
    """Return the recorded columns beside those shown, in the order of the system; the first one is the time."""
    return tuple(column.name for column in header.spec.columns[1:] if column.name not in shown)


def limits(header: Header, names: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Return (quantity, limit) of every predicate about one of `names`; of an absolute value two."""
    tree = formula(header)
    found = {limit for predicate in predicates(tree) for limit in _limits(predicate)} if tree else set()
    return tuple(limit for limit in sorted(found) if limit[0] in names)


def quantity(predicate: Comparison) -> str:
    """Return what a predicate compares with a number: a column, or one of its sides, or both as a difference.

    >>> [quantity(parse_formula(text)) for text in ("abs(phi) <= 0.95", "y2 - y1 <= 20", "speed < 2 * rpm")]
    ['phi', 'y2 - y1', 'speed - 2 * rpm']
    """
    return next(_limits(predicate))[0]


def quantity_unit(header: Header, name: str) -> str:
    """Return the unit of a quantity; empty for an expression that has none of its columns."""
    units = header.spec.units
    return units[name] if name in units else unit_of(_predicate(name), units) or ""


def values_of(trajectory: Trajectory, name: str) -> Floats:
    """Return the values of a quantity over a trajectory, (T,)."""
    if name in trajectory.columns:
        return trajectory.column(name)
    return Signals(trajectory.columns, trajectory.samples).any_margins(_predicate(name))


def of_trajectory(
    header: Header,
    names: Sequence[str],
    trajectory: Trajectory,
    label: str,
    variant: str,
    *,
    rollout: str = "",
    most: int = MOST_POINTS,
) -> Iterator[Curve]:
    """Yield the curves of one rollout, of at most `most` points; none for a single sample, which is a number."""
    if len(trajectory.samples) < 2:
        return
    for name in names:
        t, values = thinned(trajectory.samples[:, 0], values_of(trajectory, name), most)
        yield Curve(label, variant, name, quantity_unit(header, name), t, values, rollout)


def of_signals(header: Header, x: Sequence[float]) -> Iterator[InputCurve]:
    """Yield the input signals of a start (p,) over time."""
    spec, horizon = header.spec, header.config.horizon
    if not spec.signals:
        return
    units, space = {each.name: each.unit for each in spec.declared.parameters}, header.config.space
    assert isinstance(space, dict), "a list has no input signals"
    values = start_values(spec, x, horizon)
    for shape in spec.signals:
        signal = values[shape.name]
        assert isinstance(signal, InputSignal), "the system declares it"
        # Steps are vertical: a point before each knot, and one at it.
        knots = tuple(t for t in signal.times if t <= horizon)
        t = np.unique([*np.linspace(0.0, horizon, _points(signal)), *knots, *_before(signal)])
        each = space[shape.name]
        yield InputCurve(
            name=shape.name,
            unit=units[shape.name],
            kind=signal.kind,
            t=tuple(t.tolist()),
            values=tuple(signal(t).tolist()),
            # More marks are a line of their own.
            knots=knots if len(knots) <= MOST_KNOTS else (),
            low=each.low,
            high=each.high if each.high > each.low else each.low + 1.0,
        )


def _before(signal: InputSignal) -> list[float]:
    return [t * (1 - 1e-6) for t in signal.times if t <= signal.horizon] if signal.kind == "constant" else []


def _points(signal: InputSignal) -> int:
    """Return how many points show a signal beside its knots: of a sine so many that each period is seen."""
    if signal.wave is None:
        return INPUT_POINTS
    return min(INPUT_POINTS + int(PER_PERIOD * signal.wave.frequency * signal.horizon), MOST_INPUT_POINTS)


def thinned(t: Floats, values: Floats, most: int = MOST_POINTS) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return a curve (T,) with at most `most` points: its ends, and least and greatest value of equal parts."""
    rows = np.arange(len(t))
    if len(t) > most:
        # The extremes and not every n-th sample: a short peak may be the one that violates the specification.
        parts = np.array_split(rows[1:-1], (most - 2) // 2)
        extremes = [part[pick] for part in parts for pick in (np.argmin(values[part]), np.argmax(values[part]))]
        rows = np.unique([0, *extremes, len(t) - 1])
    return tuple(t[rows].tolist()), tuple(values[rows].tolist())


def _limits(predicate: Comparison) -> Iterator[tuple[str, float]]:
    """Yield the limits of what a predicate compares: two for an absolute value of a column."""
    for side, other in ((predicate.left, predicate.right), (predicate.right, predicate.left)):
        match side, _constant(other):
            case _, None:
                continue
            case Column(name), float(limit):
                yield name, limit
            case Negative(Column(name)), float(limit):
                yield name, -limit
            case Absolute(Column(name)), float(limit):
                yield name, -limit
                yield name, limit
            case _, float(limit):
                yield text(side), limit
        return
    yield text(Arithmetic("-", predicate.left, predicate.right)), 0.0


def _predicate(name: str) -> Comparison:
    """Return a predicate whose margin is the quantity."""
    found = parse_formula(f"{name} >= 0")
    assert isinstance(found, Comparison), "the text of an expression"
    return found


def _constant(tree: Expression) -> float | None:
    match tree:
        case Number(value):
            return value
        case Negative(Number(value)):
            return -value
        case _:
            return None
