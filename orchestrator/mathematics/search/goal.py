"""What a search looks for, in the terms in which it models it: the violation of a formula by those of its parts.

| symbol | name     | meaning                                                                     | shape  | unit |
|--------|----------|-----------------------------------------------------------------------------|--------|------|
| r_j    | `values` | robustness of part j of the formula                                         | (n, k) | any  |
| rho    |          | robustness of the formula: minima and maxima of r_j                         | (n,)   | any  |
| l_j    |          | logarithm of the probability that part j is below 0                         | (k, m) | -    |

| c      | `scale`  | divides the robustness of the predicates of a column                        | ()     | any  |

The smallest of several signals has a kink wherever another one becomes the smallest, and hides all others: each part is
smoother than their minimum, and has a scale of its own.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..gp.kernels import Floats
from ..stl.tree import (
    HALF,
    Absolute,
    Always,
    And,
    Arithmetic,
    Comparison,
    Eventually,
    Expression,
    Formula,
    Historically,
    Implies,
    Not,
    Number,
    Once,
    Or,
    columns,
    predicates,
    with_predicates,
)

MOST = 8
"""Parts with models of their own; a formula with more is one part."""


@dataclass(frozen=True, slots=True)
class Part:
    """The part with this number."""

    number: int


@dataclass(frozen=True, slots=True)
class Every:
    """A conjunction: the minimum."""

    of: "tuple[Goal, ...]"


@dataclass(frozen=True, slots=True)
class Some:
    """A disjunction: the maximum."""

    of: "tuple[Goal, ...]"


Goal = Part | Every | Some
ALONE = Part(0)
"""The goal of a formula that is one part."""


def goal_of(tree: Formula) -> tuple[Goal, tuple[Formula, ...]]:
    """Return the goal of a formula and its parts: minima and maxima of their robustness are the formula's.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> goal, parts = goal_of(parse_formula("always (x < 1 and y < 2) and (always x < 1 implies eventually y > 0)"))
    >>> goal
    Every(of=(Part(number=0), Part(number=1), Some(of=(Part(number=2), Part(number=3)))))
    """
    found: list[Formula] = []
    goal = _split(tree, found, fails=False)
    return (goal, tuple(found)) if len(found) <= MOST else (ALONE, (tree,))


def _split(tree: Formula, found: list[Formula], *, fails: bool) -> Goal:
    """Return the goal of a formula, or of its negation where it `fails`; add its parts to those that are `found`."""
    match tree:
        case Not(operand):
            return _split(operand, found, fails=not fails)
        case Implies(left, right):
            return _split(Or(Not(left), right), found, fails=fails)
        case And(left, right) | Or(left, right):
            sides = _split(left, found, fails=fails), _split(right, found, fails=fails)
            kind = Every if isinstance(tree, And) != fails else Some
            return kind(tuple(each for side in sides for each in (side.of if isinstance(side, kind) else (side,))))
        # Of every moment a conjunction is one of conjuncts; the other two pairs have no such rule.
        case Always(And(left, right)) | Historically(And(left, right)):
            return _split(And(replace(tree, operand=left), replace(tree, operand=right)), found, fails=fails)
        case Eventually(Or(left, right)) | Once(Or(left, right)):
            return _split(Or(replace(tree, operand=left), replace(tree, operand=right)), found, fails=fails)
    part: Formula = Not(tree) if fails else tree
    if part not in found:
        found.append(part)
    return Part(found.index(part))


def scaled(tree: Formula, scale: Mapping[str, float]) -> Formula:
    """Return a formula with the robustness of each predicate divided by the largest scale of its columns.

    Inside one part the predicate with the larger unit hides the others. No sign changes: the robustness of the result
    is below 0 where that of `tree` is. That of numbers alone is divided by the largest scale.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> from perfbound.orchestrator.mathematics.stl.text import text
    >>> text(scaled(parse_formula("always (speed < 120 or rpm < 4750)"), {"speed": 100, "rpm": 5000}))
    'always ((120 - speed) / 100 >= 0 or (4750 - rpm) / 5000 >= 0)'
    """
    largest = max(scale.values())
    return with_predicates(
        tree,
        lambda each: _divided(each, max((scale[name] for name in columns(each) if name in scale), default=largest)),
    )


def without_scale(tree: Formula, scale: Mapping[str, float]) -> Comparison | None:
    """Return a predicate of columns of which none has a scale."""
    return next((each for each in predicates(tree) if columns(each) and not columns(each) & scale.keys()), None)


def _divided(predicate: Comparison, by: float) -> Comparison:
    left, right = predicate.left, predicate.right
    margin: Expression
    match predicate.operator:
        case "<=" | "<":
            margin = Arithmetic("-", right, left)
        case ">=" | ">":
            margin = Arithmetic("-", left, right)
        case "==":
            margin = Arithmetic("-", Number(HALF), Absolute(Arithmetic("-", left, right)))
        case "!=":
            margin = Arithmetic("-", Absolute(Arithmetic("-", left, right)), Number(HALF))
    # The margin as a whole: the quotients of both sides may round to one number.
    return Comparison(">=", Arithmetic("/", margin, Number(float(by))), Number(0.0))


def numbers(goal: Goal) -> Iterator[int]:
    """Yield the number of the part at each place of a goal.

    >>> list(numbers(Some((Part(0), Every((Part(1), Part(0)))))))
    [0, 1, 0]
    """
    if isinstance(goal, Part):
        yield goal.number
    else:
        for each in goal.of:
            yield from numbers(each)


def margins(goal: Goal, values: Floats) -> Floats:
    """Return the robustness (n,) of the formula from that of its parts (n, k).

    >>> margins(Some((Part(0), Every((Part(1), Part(2))))), np.array([[1.0, 2.0, 3.0], [-1.0, 2.0, -3.0]])).tolist()
    [2.0, -1.0]
    """
    match goal:
        case Part(number):
            return values[:, number]
        case Every(of):
            return np.asarray(np.min([margins(each, values) for each in of], axis=0), dtype=np.float64)
        case Some(of):
            return np.asarray(np.max([margins(each, values) for each in of], axis=0), dtype=np.float64)


def log_failure(goal: Goal, logs: Sequence[Floats]) -> Floats:
    """Return the logarithm of the probability that the formula fails, from those of its parts, (m,) each.

    Of a conjunction that of the likeliest part, which is a lower bound; parts of a disjunction count as independent.
    """
    match goal:
        case Part(number):
            return logs[number]
        case Every(of):
            return np.asarray(np.max([log_failure(each, logs) for each in of], axis=0), dtype=np.float64)
        case Some(of):
            return np.asarray(np.sum([log_failure(each, logs) for each in of], axis=0), dtype=np.float64)
