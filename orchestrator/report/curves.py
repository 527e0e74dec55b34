"""Which columns a problem is about, the limits on them, and curves that are few numbers and look the same."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...schemas.campaign import Problem
from ...schemas.facts import Header
from ..mathematics.stl.formula import FormulaError, parse
from ..mathematics.stl.tree import (
    Absolute,
    Column,
    Comparison,
    Expression,
    Formula,
    Negative,
    Number,
    columns,
    predicates,
)

Floats = NDArray[np.float64]

MOST_POINTS = 240
"""Of one curve."""
MOST_COLUMNS = 3
"""Of one scene."""


def formula(header: Header) -> Formula | None:
    """Return the specification; None if there is none, or this perfbound cannot read it."""
    text = header.config.specification
    try:
        return None if text is None else parse(text, [column.name for column in header.spec.columns])
    except FormulaError:
        return None


def shown(header: Header, problem: Problem) -> tuple[str, ...]:
    """Return the columns that a person should see of a problem's rollouts, in the order of the system."""
    gap = header.config.gap_of(problem) if problem.name == "sim_gap" else None
    wanted: frozenset[str | None]
    if problem.name == "maximum":
        wanted = frozenset({problem.column})
    elif gap is not None and gap.column is not None:
        wanted = frozenset({gap.column})
    else:
        tree = formula(header)
        wanted = columns(tree) if tree else frozenset()
    return tuple(column.name for column in header.spec.columns if column.name in wanted)[:MOST_COLUMNS]


def limits(header: Header, names: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Return (column, limit) of every predicate that compares one column, or its absolute value, with a number."""
    tree = formula(header)
    found = [limit for predicate in predicates(tree) for limit in _limits(predicate)] if tree else []
    return tuple(dict.fromkeys(limit for limit in sorted(found) if limit[0] in names))


def column_unit(header: Header, name: str) -> str:
    """Return the unit of a column of the system."""
    return next(column.unit for column in header.spec.columns if column.name == name)


def thinned(t: Floats, values: Floats) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return a curve (T,) with at most `MOST_POINTS` points: its ends, and least and greatest value of equal parts."""
    rows = np.arange(len(t))
    if len(t) > MOST_POINTS:
        parts = np.array_split(rows[1:-1], (MOST_POINTS - 2) // 2)
        extremes = [part[pick] for part in parts for pick in (np.argmin(values[part]), np.argmax(values[part]))]
        rows = np.unique([0, *extremes, len(t) - 1])
    return tuple(t[rows].tolist()), tuple(values[rows].tolist())


def _limits(predicate: Comparison) -> Iterator[tuple[str, float]]:
    for name, sign, limit in _sides(predicate):
        yield name, sign * limit


def _sides(predicate: Comparison) -> tuple[tuple[str, float, float], ...]:
    """Return (column, sign, limit) if one side is a column and the other a number; both signs for an absolute value."""
    for one, other in ((predicate.left, predicate.right), (predicate.right, predicate.left)):
        number = _number(other)
        if number is None:
            continue
        match one:
            case Column(name):
                return ((name, 1.0, number),)
            case Negative(Column(name)):
                return ((name, -1.0, number),)
            case Absolute(Column(name)):
                return ((name, -1.0, number), (name, 1.0, number))
    return ()


def _number(tree: Expression) -> float | None:
    match tree:
        case Number(value):
            return value
        case Negative(Number(value)):
            return -value
        case _:
            return None
