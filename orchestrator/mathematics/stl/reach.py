"""The range of robustness that a formula can reach, whatever the trajectory: interval arithmetic on its predicates.

Columns may have any value. The robustness of `abs(phi) <= 0.75` is never above 0.75: a clip that ends there hides
nothing.
"""

import math
from collections.abc import Callable
from itertools import product

from .tree import (
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
    Until,
)

Range = tuple[float, float]
"""Least and largest value; either may be infinite."""
ANY: Range = (-math.inf, math.inf)


def reach(tree: Formula) -> Range:
    """Return an interval that contains the robustness of `tree` on every trajectory, in its unit.

    It may be too wide, never too narrow: a column that occurs twice counts as two.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> reach(parse_formula("always (abs(phi) <= 0.75)")), reach(parse_formula("x > 1 or x^2 <= 4"))
    ((-inf, 0.75), (-inf, inf))
    >>> reach(parse_formula("not (abs(x) + 1 <= 0.5 and y > 0)"))
    (0.5, inf)
    """
    match tree:
        case Comparison(operator, left, right):
            larger, smaller = (right, left) if operator in {"<=", "<"} else (left, right)
            return _difference(_range(larger), _range(smaller))
        case Not(operand):
            return _negative(reach(operand))
        case And(left, right):
            return _extreme(min, reach(left), reach(right))
        case Or(left, right):
            return _extreme(max, reach(left), reach(right))
        case Implies(left, right):
            return _extreme(max, _negative(reach(left)), reach(right))
        case Always(operand) | Eventually(operand):
            return reach(operand)  # an extreme of values of the operand
        case Until(left, right):
            # Some value of `right`, or a smaller one of `left`.
            first, second = reach(left), reach(right)
            return min(first[0], second[0]), second[1]


def _range(tree: Expression) -> Range:
    match tree:
        case Number(value):
            return value, value
        case Column():
            return ANY
        case Negative(operand):
            return _negative(_range(operand))
        case Absolute(operand):
            return _absolute(_range(operand))
        case Arithmetic(operator, left, right):
            return _arithmetic(operator, _range(left), _range(right))


def _arithmetic(operator: str, left: Range, right: Range) -> Range:
    if operator == "+":
        return _difference(left, _negative(right))
    if operator == "-":
        return _difference(left, right)
    if operator == "*":
        # 0 times an infinite end is 0: the ends are limits, and no value of a column is infinite.
        found = [0.0 if 0.0 in pair else pair[0] * pair[1] for pair in product(left, right)]
        return min(found), max(found)
    # An even power is at least 0 and has its least value nearest to 0; of every other one, and of a quotient, nothing.
    if operator == "^" and right[0] == right[1] and right[0] > 0.0 and right[0] % 2 == 0.0:
        low, high = _absolute(left)
        return _power(low, right[0]), _power(high, right[0])
    return ANY


def _absolute(found: Range) -> Range:
    ends = abs(found[0]), abs(found[1])
    return (0.0 if found[0] <= 0.0 <= found[1] else min(ends)), max(ends)


def _power(base: float, exponent: float) -> float:
    try:
        return float(base**exponent)
    except OverflowError:
        return math.inf


def _negative(found: Range) -> Range:
    return -found[1], -found[0]


def _difference(one: Range, other: Range) -> Range:
    low, high = one[0] - other[1], one[1] - other[0]
    # The difference of two infinite ends is no number, and then anything.
    return (-math.inf if math.isnan(low) else low), (math.inf if math.isnan(high) else high)


def _extreme(of: Callable[[float, float], float], one: Range, other: Range) -> Range:
    return of(one[0], other[0]), of(one[1], other[1])
