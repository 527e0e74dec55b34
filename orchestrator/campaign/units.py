"""Formulas whose predicates have several units: the robustness is then a number of whichever is the smallest."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

from ...schemas.file.config import CampaignConfig
from ...schemas.system import SystemSpec
from ..mathematics.stl import tree as stl
from ..mathematics.stl.parser import parse_formula
from ..mathematics.stl.text import text

MOST_NODES = 200
"""Of a formula that is written anew."""


def mixed_units(config: CampaignConfig, spec: SystemSpec) -> Iterator[str]:
    """Yield a line for every formula with several units, and the same formula in shares of its limits."""
    units = {each.name: each.unit for each in spec.columns}
    named: dict[str, str | None] = {each.name: each.formula for each in config.specifications}
    for name, formula in (named or {"specification": config.formula}).items():
        if formula is None:
            continue
        tree = parse_formula(formula, tuple(units))
        found = {_unit(each, units) for each in stl.predicates(tree)}
        listed = [each or "numbers" for each in dict.fromkeys(units.values()) if each in found]
        if len(listed) < 2:
            continue
        scaled = _scaled(tree) if sum(1 for _ in stl.walk(tree)) <= MOST_NODES else None
        way = "divide each by a scale of its own" if scaled is None else f"in shares of each limit: {text(scaled)}"
        yield (
            f"{name}: its parts are in {', '.join(listed[:-1])} and {listed[-1]}, and its robustness is the smallest "
            f"of them, whatever the unit; {way}"
        )


def _unit(predicate: stl.Comparison, units: Mapping[str, str]) -> str | None:
    """Return the unit of a predicate; None where its columns have several, or are multiplied."""
    found = {units[name] for name in stl.columns(predicate)}
    multiplied = any(isinstance(each, stl.Arithmetic) and each.operator in "*/^" for each in stl.walk(predicate))
    return found.pop() if len(found) == 1 and not multiplied else None


def _scaled(tree: Any) -> Any:
    """Return a formula with every predicate divided by its limit; None where one has no limit but 0."""
    if isinstance(tree, stl.Comparison):
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
