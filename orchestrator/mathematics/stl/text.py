"""Text of a tree, with the fewest parentheses that the grammar needs: `parse_formula(text(tree)) == tree`."""

from .tree import (
    REST,
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
    Interval,
    Negative,
    Node,
    Not,
    Number,
    Or,
    Temporal,
    Until,
)

__all__ = ["excerpt", "number", "operator", "text"]

_EXCERPT = 60

Piece = str | Node

# Binding strengths of the grammar's rules, loosest first.
_FORMULA, _DISJUNCTION, _CONJUNCTION, _UNTIL, _UNARY, _SUM, _PRODUCT, _SIGN, _POWER, _ATOM = range(10)
_BINDING = {"+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "^": _POWER}


def text(tree: Node) -> str:
    """Return a text that `parse_formula` reads as `tree`.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> text(parse_formula("(always[0,15] (abs(phi)<=.95)) and ((x<1) until[2,inf) (y+1)^2>3)"))
    'always[0,15] abs(phi) <= 0.95 and x < 1 until[2,inf) (y + 1)^2 > 3'

    """
    written: list[str] = []
    to_write: list[Piece] = [tree]  # last first; no recursion, because a sum may be 500 nodes deep
    while to_write:
        piece = to_write.pop()
        if isinstance(piece, str):
            written.append(piece)
        else:
            to_write.extend(reversed(_expression(piece) if isinstance(piece, Expression) else _formula(piece)))
    return "".join(written)


def excerpt(tree: Node) -> str:
    """Return the text of `tree`, cut where it is too long for a message."""
    whole = text(tree)
    return whole if len(whole) <= _EXCERPT else f"{whole[:_EXCERPT]}..."


def number(value: float) -> str:
    """Return a number in its shortest form: 15, 0.25, 1e-09."""
    return repr(float(value)).removesuffix(".0")


def operator(tree: Temporal) -> str:
    """Return the word of a temporal operator."""
    match tree:
        case Always():
            return "always"
        case Eventually():
            return "eventually"
        case Until():
            return "until" if tree.reading == "standard" else "until_from"


def _formula(tree: Formula) -> list[Piece]:
    match tree:
        case Comparison(sign, left, right):
            return [*_within(left, _SUM), f" {sign} ", *_within(right, _SUM)]
        case Not(operand):
            return ["not ", *_within(operand, _UNARY)]
        case Always(operand, interval) | Eventually(operand, interval):
            return [f"{operator(tree)}{_brackets(interval)} ", *_within(operand, _UNARY)]
        case Until(left, right, interval):
            return [*_within(left, _UNARY), f" {operator(tree)}{_brackets(interval)} ", *_within(right, _UNARY)]
        case And(left, right):
            return [*_within(left, _CONJUNCTION), " and ", *_within(right, _UNTIL)]
        case Or(left, right):
            return [*_within(left, _DISJUNCTION), " or ", *_within(right, _CONJUNCTION)]
        case Implies(left, right):
            return [*_within(left, _DISJUNCTION), " implies ", *_within(right, _FORMULA)]


def _expression(tree: Expression) -> list[Piece]:
    match tree:
        case Number(value):
            return [number(value)]
        case Column(name):
            return [name]
        case Negative(operand):
            return ["-", *_within(operand, _SIGN)]
        case Absolute(operand):
            return ["abs(", operand, ")"]
        case Arithmetic("^", left, right):
            return [*_within(left, _ATOM), "^", *_within(right, _SIGN)]
        case Arithmetic(sign, left, right):
            binding = _BINDING[sign]
            return [*_within(left, binding), f" {sign} ", *_within(right, binding + 1)]


def _within(tree: Node, binding: int) -> list[Piece]:
    """Return an operand, in parentheses if it binds more loosely than its place needs."""
    return [tree] if _binding(tree) >= binding else ["(", tree, ")"]


def _binding(tree: Node) -> int:
    match tree:
        case Implies():
            return _FORMULA
        case Or():
            return _DISJUNCTION
        case And():
            return _CONJUNCTION
        case Until():
            return _UNTIL
        case Arithmetic():
            return _BINDING[tree.operator]
        case Negative():
            return _SIGN
        case Number() | Column() | Absolute():
            return _ATOM
        case _:
            return _UNARY


def _brackets(interval: Interval) -> str:
    if interval == REST:
        return ""
    end = f"{number(interval.high)}]" if interval.bounded else "inf)"
    return f"[{number(interval.low)},{end}"
