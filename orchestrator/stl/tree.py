"""The tree of an STL formula: frozen nodes, either expressions (numbers) or formulas (conditions)."""

from dataclasses import dataclass, fields
from typing import Literal

ArithmeticOperator = Literal["+", "-", "*", "/", "^"]
Comparator = Literal["<=", ">=", "<", ">"]


@dataclass(frozen=True, slots=True)
class Number:
    """A constant."""

    value: float


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
    """At every sample from now to the end of the trajectory."""

    operand: "Formula"


@dataclass(frozen=True, slots=True)
class Eventually:
    """At some sample from now to the end of the trajectory."""

    operand: "Formula"


Formula = Comparison | Not | And | Or | Implies | Always | Eventually
Node = Expression | Formula


def columns(tree: Node) -> frozenset[str]:
    """Return the names of the columns that `tree` reads.

    >>> sorted(columns(Always(Comparison("<=", Arithmetic("+", Column("x"), Column("y")), Number(1.0)))))
    ['x', 'y']
    """
    names: set[str] = set()
    open_nodes: list[Node] = [tree]
    while open_nodes:
        node = open_nodes.pop()
        if isinstance(node, Column):
            names.add(node.name)
        parts = (getattr(node, f.name) for f in fields(node))
        open_nodes.extend(part for part in parts if isinstance(part, Node))
    return frozenset(names)
