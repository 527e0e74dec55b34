"""Formulas whose predicates have several units: the robustness is then a number of whichever is the smallest."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

from . import tree as stl
from .parser import parse_formula
from .text import text

MOST_NODES = 200
"""Of a formula that is written anew."""


def mixed_units(formulas: Mapping[str, str], units: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for every formula with several units, and the same formula in shares of its limits.

    `formulas` by their names, `units` by the names of the columns.

    Raises:
        FormulaError: one is no formula over these columns.

    """
    for name, formula in formulas.items():
        tree = parse_formula(formula, units)
        found = {unit_of(each, units) for each in stl.predicates(tree)}
        listed = [each or "numbers" for each in dict.fromkeys(units.values()) if each in found]
        if len(listed) < 2:
            continue
        scaled = _scaled(tree) if sum(1 for _ in stl.walk(tree)) <= MOST_NODES else None
        way = "divide each by a scale of its own" if scaled is None else f"in shares of each limit: {text(scaled)}"
        yield (
            f"{name}: its parts are in {', '.join(listed[:-1])} and {listed[-1]}, and its robustness is the smallest "
            f"of them, whatever the unit; {way}"
        )


def unit_of(predicate: stl.Comparison, units: Mapping[str, str]) -> str | None:
    """Return the unit of both sides of a predicate; None where its columns have several, or are multiplied."""
    found = {units[name] for name in stl.columns(predicate)}
    multiplied = any(
        (isinstance(each, stl.Arithmetic) and each.operator in "*/^")
        or (isinstance(each, stl.Function) and each.name not in {"max", "min"})
        for each in stl.walk(predicate)
    )
    return found.pop() if len(found) == 1 and not multiplied else None


def _scaled(tree: Any) -> Any:
    """Return a formula with every predicate divided by its limit; None where one has no limit but 0."""
    if isinstance(tree, stl.Comparison):
        if tree.operator in {"==", "!="}:  # a number of steps, and so no unit
            return tree
        limit = tree.right.operand if isinstance(tree.right, stl.Negative) else tree.right
        if not isinstance(limit, stl.Number) or limit.value == 0.0:
            return None
        one: stl.Expression = stl.Number(1.0)
        right = stl.Negative(one) if isinstance(tree.right, stl.Negative) else one
        return replace(tree, left=stl.Arithmetic("/", tree.left, limit), right=right)
    changes = {}
    for each in fields(tree):
        value = getattr(tree, each.name)
        if isinstance(value, stl.Interval | str):
            continue
        if (changed := _scaled(value)) is None:
            return None
        changes[each.name] = changed
    return replace(tree, **changes)
