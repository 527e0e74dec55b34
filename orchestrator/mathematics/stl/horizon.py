"""Horizon of a formula: how far into the future its value reaches, and a check that a trajectory is long enough.

| symbol | name       | meaning                                                              | unit |
|--------|------------|----------------------------------------------------------------------|------|
| T      | `duration` | time from the first sample of a trajectory to its last                | s    |
| h      | `horizon`  | a formula's value at t depends on [t, t + h] at most                  | s    |
|        | `latest`   | latest time at which a part is read, when the whole is read at time 0 | s    |
"""

import math
from collections.abc import Sequence

from .errors import FormulaError
from .text import excerpt, head, number, operator
from .tree import Ahead, Behind, Comparison, Formula, Interval, Since, operands

__all__ = ["check_horizon", "horizon"]

ROUND_OFF = 1e-9
"""Of the sum of the ends of intervals, in s."""


def horizon(tree: Formula) -> float:
    """Return how far from now the value of `tree` depends on the trajectory, in s; inf if to its end.

    Formula: 0 for a predicate; the largest of its operands' for not, and, or, implies; b + that for an interval [a, b];
    of an operand h seconds ahead that is read a seconds ago max(h - a, 0). The step of `next` and `previous` counts as
    none: how long it is only a trajectory shows.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> horizon(parse_formula("always[0,10] (x <= 1 or eventually[2,5] y <= 1)"))
    15.0
    >>> horizon(parse_formula("always x <= 1"))
    inf

    """
    if isinstance(tree, Since):
        return max(horizon(tree.left), horizon(tree.right) - tree.interval.low, 0.0)
    below = max((horizon(operand) for operand in operands(tree)), default=0.0)
    if isinstance(tree, Behind):
        return max(below - tree.interval.low, 0.0)
    return tree.interval.high + below if isinstance(tree, Ahead) else below


def check_horizon(tree: Formula, duration: float, *, slack: float = 0.0) -> None:
    """Raise if a formula, read at time 0, reaches beyond the end of a trajectory that lasts `duration` seconds.

    An operator without an end of its own is read to the end of the trajectory, so its operands may reach no further
    than their own time, or to the end. What an operator of the past reads is a seconds earlier at least. `slack` is how
    far from the last sample a moment is still the same instant.

    Raises:
        FormulaError: an interval ends after `duration`; with the remedy. Its position is None.
        ValueError: `duration` is negative or not finite.

    """
    if not (math.isfinite(duration) and duration >= 0):
        raise ValueError(f"a trajectory lasts 0 s or longer, not {duration!r}")
    _check(tree, 0.0, (duration, duration + slack + ROUND_OFF), ())


def _check(tree: Formula, latest: float, end: tuple[float, float], around: tuple[Ahead, ...]) -> None:
    """Check `tree`, read until `latest`, under the operators `around` it, the innermost one last.

    `end` is the duration, and the latest moment that is the instant of the last sample.
    """
    duration, last = end
    if isinstance(tree, Comparison):
        return
    if isinstance(tree, Ahead):
        # Read until `latest`, the interval needs a sample this late.
        reach = latest + _last(tree.interval)
        if reach > last:
            raise FormulaError(_reason(tree, reach, duration, around))
        latest, around = reach if tree.interval.bounded else duration, (*around, tree)
    ago = tree.interval.low if isinstance(tree, Behind) else 0.0
    for operand in operands(tree):
        now = isinstance(tree, Since) and operand is tree.left
        _check(operand, latest if now else latest - ago, end, around)


def _last(interval: Interval) -> float:
    """Return the time from now at which the last sample is needed."""
    return interval.high if interval.bounded else interval.low


def _reason(tree: Ahead, reach: float, duration: float, around: Sequence[Ahead]) -> str:
    unbounded = next((each for each in reversed(around) if not each.interval.bounded), None)
    ends = [*(each.interval.high for each in around), _last(tree.interval)]
    if unbounded is None and around and math.isclose(sum(ends), reach):
        nested = " inside ".join(f"`{head(each)}`" for each in (tree, *reversed(around)))
        total = " + ".join(f"{each:.9g}" for each in ends)
        return (
            f"{nested} reaches to {total} = {reach:.9g} s, but the trajectory ends at {duration:.9g} s: shorten one of "
            "the intervals, or lengthen the horizon of the campaign"
        )
    reaches = f"`{excerpt(tree)}` reaches to {reach:.9g} s, but the trajectory ends at {duration:.9g} s"
    if unbounded is None:
        return f"{reaches}: shorten the interval, or lengthen the horizon of the campaign"
    end = number(round(max(0.0, duration - _last(tree.interval)), 9))
    return (
        f"{reaches}, to which the operator around it is read (`{excerpt(unbounded)}`): "
        f"give that one an interval that ends by {end}, e.g. {operator(unbounded)}[0,{end}]"
    )
