"""Text of a tree, with the fewest parentheses that the grammar needs: `parse_formula(text(tree)) == tree`."""

from .tree import (
    REST,
    Absolute,
    Ahead,
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
    Node,
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

__all__ = ["excerpt", "head", "number", "operator", "text"]

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


def head(tree: Ahead) -> str:
    """Return the word of an operator with its interval."""
    return f"{operator(tree)}{_brackets(tree.interval)}"


def operator(tree: Temporal | Not) -> str:
    """Return the word of an operator."""
    match tree:
        case Until():
            return "until" if tree.reading == "standard" else "until_from"
        case _:
            return type(tree).__name__.lower()


def _formula(tree: Formula) -> list[Piece]:
    match tree:
        case Comparison(sign, left, right):
            return [*_within(left, _SUM), f" {sign} ", *_within(right, _SUM)]
        case Not(operand) | Next(operand) | Previous(operand):
            return [f"{operator(tree)} ", *_within(operand, _UNARY)]
        case Rise(operand) | Fall(operand):
            return [f"{operator(tree)}(", operand, ")"]
        case (
            Always(operand, interval)
            | Eventually(operand, interval)
            | Historically(operand, interval)
            | Once(operand, interval)
        ):
            return [f"{operator(tree)}{_brackets(interval)} ", *_within(operand, _UNARY)]
        case Until(left, right, interval) | Since(left, right, interval):
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
        case Function(name, arguments):
            return [f"{name}(", *[piece for each in arguments for piece in (", ", each)][1:], ")"]
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
        case Until() | Since():
            return _UNTIL
        case Arithmetic():
            return _BINDING[tree.operator]
        case Negative():
            return _SIGN
        case Number() | Column() | Absolute() | Function():
            return _ATOM
        case _:
            return _UNARY


def _brackets(interval: Interval) -> str:
    if interval == REST:
        return ""
    opening, closing = "(" if interval.low_open else "[", ")" if interval.high_open else "]"
    end = f"{number(interval.high)}{closing}" if interval.bounded else "inf)"
    return f"{opening}{number(interval.low)},{end}"
