"""The range of robustness that a formula can reach, whatever the trajectory: interval arithmetic on its predicates.

Columns may have any value. The robustness of `abs(phi) <= 0.75` is never above 0.75: a clip that ends there hides
nothing.
"""

import math
from collections.abc import Callable
from functools import partial, reduce
from itertools import product

from ....schemas.values import Beyond
from .tree import (
    HALF,
    Absolute,
    Always,
    And,
    Arithmetic,
    Column,
    Comparison,
    Eventually,
    Expression,
    Fall,
    Formula,
    Function,
    Historically,
    Implies,
    Interval,
    Negative,
    Next,
    Not,
    Number,
    Once,
    Or,
    Previous,
    Rise,
    Since,
    Temporal,
    Until,
)

Range = tuple[float, float]
"""Least and largest value; either may be infinite."""
ANY: Range = (-math.inf, math.inf)


def reach(tree: Formula, beyond: Beyond = "refuse") -> Range:
    """Return an interval that contains the robustness of `tree` on every trajectory, in its unit.

    It may be too wide, never too narrow: a column that occurs twice counts as two. With `beyond` = "truncate" windows
    beyond the end may be empty.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> reach(parse_formula("always (abs(phi) <= 0.75)")), reach(parse_formula("x > 1 or x^2 <= 4"))
    ((-inf, 0.75), (-inf, inf))
    >>> reach(parse_formula("not (abs(x) + 1 <= 0.5 and y > 0)"))
    (0.5, inf)
    """
    match tree:
        case Comparison():
            return _margin(tree)
        case Not(operand):
            return _negative(reach(operand, beyond))
        case And(left, right):
            return _extreme(min, reach(left, beyond), reach(right, beyond))
        case Or(left, right):
            return _extreme(max, reach(left, beyond), reach(right, beyond))
        case Implies(left, right):
            return _extreme(max, _negative(reach(left, beyond)), reach(right, beyond))
        case _:
            return _over_time(tree, beyond)


def _margin(tree: Comparison) -> Range:
    left, right = _range(tree.left), _range(tree.right)
    if tree.operator in {"==", "!="}:
        apart = _absolute(_difference(left, right))
        half = (HALF, HALF)
        return _difference(half, apart) if tree.operator == "==" else _difference(apart, half)
    larger, smaller = (right, left) if tree.operator in {"<=", "<"} else (left, right)
    return _difference(larger, smaller)


def _over_time(tree: Temporal, beyond: Beyond) -> Range:
    """Return the range of an extreme of values of the operand; over no sample it is infinite."""
    ahead = beyond == "truncate"
    match tree:
        case Always(operand, interval):
            return _or_none(reach(operand, beyond), math.inf, ahead and _may_be_empty(interval))
        case Eventually(operand, interval):
            return _or_none(reach(operand, beyond), -math.inf, ahead and _may_be_empty(interval))
        case Historically(operand, interval):
            return _or_none(reach(operand, beyond), math.inf, _may_be_empty(interval))
        case Once(operand, interval):
            return _or_none(reach(operand, beyond), -math.inf, _may_be_empty(interval))
        case Next(operand):
            return _or_none(reach(operand, beyond), -math.inf, ahead)
        case Previous(operand):
            return _or_none(reach(operand, beyond), -math.inf, True)
        case Until(left, right, interval) | Since(left, right, interval):
            # Some value of `right`, or a smaller one of `left`.
            first, second = reach(left, beyond), reach(right, beyond)
            empty = (ahead or isinstance(tree, Since)) and _may_be_empty(interval)
            return _or_none((min(first[0], second[0]), second[1]), -math.inf, empty)
        case Rise(operand) | Fall(operand):
            low, high = reach(operand, beyond)
            return -math.inf, min(-low, high)


def _may_be_empty(interval: Interval) -> bool:
    """Whether a window at the start or at the end of a trajectory may have no sample: not if it has its own one."""
    return interval.low > 0.0 or interval.low_open


def _or_none(found: Range, value: float, empty: bool) -> Range:
    """Return a range with the value over no sample, if that may be."""
    return (min(found[0], value), max(found[1], value)) if empty else found


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
        case Function(name, arguments):
            return _function(name, [_range(each) for each in arguments])


def _function(name: str, found: list[Range]) -> Range:
    low, high = found[0]
    match name:
        case "max" | "min":
            return reduce(partial(_extreme, max if name == "max" else min), found)
        case "sin" | "cos":
            return -1.0, 1.0
        case "sqrt" if high >= 0.0:
            return math.sqrt(max(low, 0.0)), math.sqrt(high)
        case "exp":  # two libraries may round it differently
            return max(0.0, _nearby(_exponential(low), -math.inf)), _nearby(_exponential(high), math.inf)
        case "log" if high > 0.0:
            least = math.log(low) if low > 0.0 else -math.inf
            return _nearby(least, -math.inf), _nearby(math.log(high), math.inf)
        case _:
            return ANY


def _exponential(value: float) -> float:
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


def _nearby(value: float, towards: float) -> float:
    return math.nextafter(math.nextafter(value, towards), towards)


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
