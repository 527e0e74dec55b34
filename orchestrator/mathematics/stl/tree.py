"""Nodes of an STL formula's tree, frozen: either expressions (numbers) or formulas (conditions)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Literal

ArithmeticOperator = Literal["+", "-", "*", "/", "^"]
Comparator = Literal["<=", ">=", "<", ">"]
Reading = Literal["standard", "paper"]
"""Semantics of the left operand of `until`: from now on, or from the start of the interval on as in [ARA]."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Seconds from now, both ends included; `high` = inf means to the end of the trajectory.

    Raises:
        ValueError: not 0 <= low <= high, or `low` is not finite.

    """

    low: float = 0.0
    high: float = math.inf

    def __post_init__(self) -> None:
        if not (0 <= self.low <= self.high and math.isfinite(self.low)):
            raise ValueError(f"an interval needs 0 <= low <= high, not [{self.low!r}, {self.high!r}]")

    @property
    def bounded(self) -> bool:
        """Whether the interval has an end of its own."""
        return math.isfinite(self.high)


REST = Interval()
"""From now to the end of the trajectory: the interval of an operator without one."""


@dataclass(frozen=True, slots=True)
class Number:
    """A constant; a negative one is `Negative(Number(...))`.

    Raises:
        ValueError: the value is negative or not finite.

    """

    value: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or math.copysign(1.0, self.value) < 0:
            raise ValueError(f"a number in a formula is finite and not negative, not {self.value!r}")


@dataclass(frozen=True, slots=True)
class Column:
    """The value of a trajectory's column."""

    name: str


@dataclass(frozen=True, slots=True)
class Negative:
    """-operand."""

    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Absolute:
    """abs(operand)."""

    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """left operator right, on numbers."""

    operator: ArithmeticOperator
    left: "Expression"
    right: "Expression"


Expression = Number | Column | Negative | Absolute | Arithmetic


@dataclass(frozen=True, slots=True)
class Comparison:
    """A predicate."""

    operator: Comparator
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    operand: "Formula"


@dataclass(frozen=True, slots=True)
class And:
    """Conjunction."""

    left: "Formula"
    right: "Formula"


@dataclass(frozen=True, slots=True)
class Or:
    """Disjunction."""

    left: "Formula"
    right: "Formula"


@dataclass(frozen=True, slots=True)
class Implies:
    """Implication."""

    left: "Formula"
    right: "Formula"


@dataclass(frozen=True, slots=True)
class Always:
    """At every sample of the interval."""

    operand: "Formula"
    interval: Interval = REST


@dataclass(frozen=True, slots=True)
class Eventually:
    """At some sample of the interval."""

    operand: "Formula"
    interval: Interval = REST


@dataclass(frozen=True, slots=True)
class Until:
    """`right` at some sample of the interval, and `left` until then: from now, or from the interval's start."""

    left: "Formula"
    right: "Formula"
    interval: Interval = REST
    reading: Reading = "standard"


Temporal = Always | Eventually | Until
Formula = Comparison | Not | And | Or | Implies | Temporal
Node = Expression | Formula

_PARTS: dict[type[Node], tuple[str, ...]] = {
    kind: tuple(field.name for field in fields(kind) if field.name in {"operand", "left", "right"})
    for kind in (
        Number,
        Column,
        Negative,
        Absolute,
        Arithmetic,
        Comparison,
        Not,
        And,
        Or,
        Implies,
        Always,
        Eventually,
        Until,
    )
}


def walk(tree: Node) -> Iterator[Node]:
    """Yield every node of `tree`, itself first."""
    open_nodes: list[Node] = [tree]
    while open_nodes:
        node = open_nodes.pop()
        yield node
        open_nodes.extend(getattr(node, part) for part in _PARTS[type(node)])


def operands(tree: Formula) -> tuple[Formula, ...]:
    """Return the formulas of which the formula `tree` is made, left to right; none for a predicate."""
    if isinstance(tree, Comparison):
        return ()
    return tuple(getattr(tree, part) for part in _PARTS[type(tree)])


def columns(tree: Node) -> frozenset[str]:
    """Return the names of the columns that `tree` reads.

    >>> sorted(columns(Always(Comparison("<=", Arithmetic("+", Column("x"), Column("y")), Number(1.0)))))
    ['x', 'y']
    """
    return frozenset(node.name for node in walk(tree) if isinstance(node, Column))


def predicates(tree: Formula) -> tuple[Comparison, ...]:
    """Return the predicates of `tree`, one for each place where it has one.

    >>> len(predicates(And(Comparison("<=", Column("x"), Number(1.0)), Comparison(">", Column("y"), Number(0.0)))))
    2
    """
    return tuple(node for node in walk(tree) if isinstance(node, Comparison))
