"""Nodes of an STL formula's tree, frozen: either expressions (numbers) or formulas (conditions)."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

ArithmeticOperator = Literal["+", "-", "*", "/", "^"]
FunctionName = Literal["max", "min", "sqrt", "sin", "cos", "tan", "exp", "log"]
Comparator = Literal["<=", ">=", "<", ">", "==", "!="]
Reading = Literal["standard", "paper"]
"""Semantics of the left operand of `until`: from now on, or from the start of the interval on as in [ARA]."""


HALF = 0.5
"""The margin of an equality between whole numbers: half of the least distance of two that differ."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Seconds from now, or of the past seconds ago; an end belongs to it unless it is open.

    `high` = inf means to the end of the trajectory, or to its start.

    Raises:
        ValueError: not 0 <= low <= high, `low` is not finite, or no time is in the interval.

    """

    low: float = 0.0
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False

    def __post_init__(self) -> None:
        if not (0 <= self.low <= self.high and math.isfinite(self.low)):
            raise ValueError(f"an interval needs 0 <= low <= high, not [{self.low!r}, {self.high!r}]")
        if self.low == self.high and (self.low_open or self.high_open):
            raise ValueError(f"an interval of one moment is [{self.low!r}, {self.low!r}], with both ends")
        if self.high_open and not self.bounded:
            raise ValueError("an interval without end has no end that is open")

    @property
    def bounded(self) -> bool:
        """Whether the interval has an end of its own."""
        return math.isfinite(self.high)


REST = Interval()
"""From now to the end of the trajectory, or of the past to its start: the interval of an operator without one."""


@dataclass(frozen=True, slots=True)
class Span:
    """The samples that an operator over time reads: those of an interval ahead or behind, or without one the next."""

    interval: Interval | None
    past: bool = False


STEP_BACK = Span(None, past=True)


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


@dataclass(frozen=True, slots=True)
class Function:
    """name(arguments), on numbers."""

    name: FunctionName
    arguments: tuple["Expression", ...]


Expression = Number | Column | Negative | Absolute | Arithmetic | Function


@dataclass(frozen=True, slots=True)
class Comparison:
    """A predicate; `==` and `!=` compare whole numbers, those of discrete columns."""

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


@dataclass(frozen=True, slots=True)
class Historically:
    """At every sample of the interval before now."""

    operand: "Formula"
    interval: Interval = REST


@dataclass(frozen=True, slots=True)
class Once:
    """At some sample of the interval before now."""

    operand: "Formula"
    interval: Interval = REST


@dataclass(frozen=True, slots=True)
class Since:
    """`right` at some sample of the interval before now, and `left` from there to now: `until`, backwards in time."""

    left: "Formula"
    right: "Formula"
    interval: Interval = REST


@dataclass(frozen=True, slots=True)
class Next:
    """At the next sample, which is there."""

    operand: "Formula"


@dataclass(frozen=True, slots=True)
class Previous:
    """At the sample before, which is there."""

    operand: "Formula"


@dataclass(frozen=True, slots=True)
class Rise:
    """False at the sample before, which is there, and true now."""

    operand: "Formula"


@dataclass(frozen=True, slots=True)
class Fall:
    """True at the sample before, which is there, and false now."""

    operand: "Formula"


Ahead = Always | Eventually | Until
Behind = Historically | Once | Since
Timed = Ahead | Behind
Edge = Rise | Fall
Temporal = Timed | Next | Previous | Edge
Formula = Comparison | Not | And | Or | Implies | Temporal
Node = Expression | Formula

_PARTS: dict[type[Node], tuple[str, ...]] = {
    kind: tuple(field.name for field in fields(kind) if field.name in {"operand", "left", "right"})
    for kind in get_args(Node)
}


def children(tree: Node) -> tuple[Node, ...]:
    """Return the nodes of which `tree` is made, left to right."""
    if isinstance(tree, Function):
        return tree.arguments
    return tuple(getattr(tree, part) for part in _PARTS[type(tree)])


def walk(tree: Node) -> Iterator[Node]:
    """Yield every node of `tree`, itself first."""
    open_nodes: list[Node] = [tree]
    while open_nodes:
        node = open_nodes.pop()
        yield node
        open_nodes.extend(children(node))


def operands(tree: Formula) -> tuple[Formula, ...]:
    """Return the formulas of which the formula `tree` is made, left to right; none for a predicate."""
    if isinstance(tree, Comparison):
        return ()
    return tuple(getattr(tree, part) for part in _PARTS[type(tree)])


def span(tree: Temporal) -> Span:
    """Return the samples that an operator over time reads; `rise` and `fall` also read their own."""
    match tree:
        case Always() | Eventually() | Until():
            return Span(tree.interval)
        case Historically() | Once() | Since():
            return Span(tree.interval, past=True)
        case Next():
            return Span(None)
        case Previous() | Rise() | Fall():
            return STEP_BACK


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


def with_predicates(tree: Formula, other: Callable[[Comparison], Formula]) -> Formula:
    """Return `tree` with another formula in the place of each predicate."""
    if isinstance(tree, Comparison):
        return other(tree)
    changed: dict[str, Any] = {part: with_predicates(getattr(tree, part), other) for part in _PARTS[type(tree)]}
    return replace(tree, **changed)
