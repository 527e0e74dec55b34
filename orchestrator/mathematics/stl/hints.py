"""What to write in place of text that no formula has, for messages: pure functions of its tokens."""

import difflib
import math
import re
from collections.abc import Collection

from ....schemas.values import DISCRETE, FORMULA_FUNCTIONS, FORMULA_WORDS
from .text import text
from .tokens import FormulaToken, tokens
from .tree import Absolute, Arithmetic, Column, Comparison, Function, Number, walk

__all__ = [
    "BETWEEN",
    "COMPARATORS",
    "UNTIL",
    "arguments",
    "clash",
    "decimal",
    "equality",
    "function",
    "surplus",
    "unexpected",
    "unit",
    "unknown",
]

COMPARATORS = ("<=", ">=", "<", ">", "==", "!=")
UNTIL = ("until", "until_from", "since")
BETWEEN = frozenset({*UNTIL, "and", "or", "implies"})
_BEGINNINGS = ("always", "eventually", "historically", "once")
_OPERATORS = (*_BEGINNINGS, *UNTIL, "next", "previous", "rise", "fall", "not", "and", "or", "implies")
_TIMED = frozenset({*_BEGINNINGS, *UNTIL})
"""Operators that may have an interval."""
_OTHERWISE = {
    "ln": "write log(x), the natural logarithm",
    "log10": "write log(x) / log(10)",
    "log2": "write log(x) / log(2)",
    "pow": "write x^2",
    "square": "write x^2",
    "norm": "write sqrt(x^2 + y^2)",
    "hypot": "write sqrt(x^2 + y^2)",
    "iff": "write `(f implies g) and (g implies f)`",
}
"""How what other functions say is written."""
_ANGLE = (math.pi / 180.0, "in rad")
_IN_OTHERS = {"deg": _ANGLE, "degrees": _ANGLE, "\u00b0": _ANGLE, "%": (0.01, "as a share")}
"""Of units that are often written where a column has another one."""


def unit(
    number: FormulaToken, word: FormulaToken, further: FormulaToken, known: Collection[str] | None, right: str
) -> str | None:
    """Return why `word` cannot follow a number in the unit `right`; None where it may, or is no unit."""
    if word.text in BETWEEN or word.text in FORMULA_WORDS:
        return None
    if word.text == "[" and further.kind == "word":  # x < 2 [m]
        word = further
    elif word.kind != "word" or (further.kind in {"word", "number"} and further.text not in BETWEEN):
        return None
    if known is not None and word.text in known:
        return f"unexpected {word.text!r}; write `{number.text} * {word.text}`, or `and` before another condition"
    factor, place = _IN_OTHERS.get(word.text, (0.0, ""))
    other = f"; {place} it is {float(number.text) * factor:.6g}" if factor else ""
    return f"unexpected {word.text!r}; write {number.text} alone, in {right}{other}"


def decimal(number: FormulaToken, comma: FormulaToken, further: FormulaToken) -> str | None:
    """Return what to write for `1,5`; None if this is no number with a decimal comma."""
    end = number.position + len(number.text)
    if comma.text != "," or further.kind != "number" or (comma.position, further.position) != (end, end + 1):
        return None
    return f"write {number.text}.{further.text} with a point"


def function(name: str, argument: str, known: Collection[str] | None) -> str:
    """Return why there is no function of this name; `argument` is the word behind its parenthesis."""
    whole = f"{name}_{argument}".lower()  # der(h) of an FMU
    near = (
        f"did you mean {whole!r}? " if whole in (known or ()) else _meant(name, (*_OPERATORS, *FORMULA_FUNCTIONS), 0.7)
    )
    hint = f"{_OTHERWISE[name]}; " if name in _OTHERWISE else near
    return f"unknown function {name!r}; {hint}there are {', '.join(FORMULA_FUNCTIONS)}"


def arguments(name: str, number: int) -> str | None:
    """Return why a function cannot have so many arguments; None where it can."""
    if name in {"max", "min"}:
        return None if number > 1 else f"{name} needs two numbers or more: {name}(x, y)"
    return None if number == 1 else f"{name} has one number between its parentheses, not {number}"


def equality(predicate: Comparison, discrete: Collection[str] | None) -> str | None:
    """Return why a predicate cannot compare by == or !=; None where it can, or does not.

    `discrete` are the columns of whole numbers; None if that is not known here.
    """
    sign = predicate.operator
    if sign not in {"==", "!="}:
        return None
    for node in walk(predicate):
        match node:
            case Number(value):
                whole, what = value.is_integer(), f"{value:g} is none"
            case Column(name):
                whole = discrete is None or name in discrete
                what = f'{name!r} is no column with the unit "{DISCRETE}"'
            case Arithmetic(operator, _, _):
                whole, what = operator not in "/^", f"what {operator} gives may be none"
            case Function(name, _):
                whole, what = name in {"max", "min"}, f"what {name} gives may be none"
            case _:
                continue
        if not whole:
            size = text(Absolute(Arithmetic("-", predicate.left, predicate.right)))
            near = f"{size} {'<=' if sign == '==' else '>'} 0.1"
            return f"{sign} compares whole numbers, and {what}: write `{near}` with your tolerance"
    return None


def clash(formula: str, known: Collection[str]) -> FormulaToken | None:
    """Return the first word of a formula that is the name of a column, too."""
    taken = FORMULA_WORDS.intersection(known)
    return next((each for each in tokens(formula) if each.text in taken), None) if taken else None


def unknown(name: str, after: FormulaToken, known: Collection[str]) -> str:
    """Return why `name` is no column."""
    if after.text == "[" and _nearest(name, {*known, *_TIMED}) in _TIMED:
        return f"there is no operator {name!r}; {_meant(name, _TIMED)}there are {', '.join(_OPERATORS)}"
    near = _meant(name, known)
    if "." in name:
        near = f"a name has no dot, write _; {_of_dots(name, known) or near}"
    return f"unknown column {name!r}; {near}known are {', '.join(known)}"


def no_operator(name: str) -> str:
    """Return why `name` is no operator."""
    near = _nearest(name, _OPERATORS)
    return f"there is no operator {name!r}; {near and f'nearest: {near}; '}there are {', '.join(_OPERATORS)}"


def surplus(token: FormulaToken) -> str:
    """Return why the text cannot continue with `token`, behind a whole phrase."""
    if token.text in UNTIL:
        return f"`{token.text}` does not chain: put one of the two into parentheses"
    if token.text == ")":
        return "unexpected ')': no '(' before it is open; remove it, or add the '('"
    reason = unexpected(token)
    if token.kind in {"word", "number"} or token.text == "(":
        reason += " here; write and, or, implies or until between two conditions" if reason.endswith("'") else ""
    return reason


def unexpected(token: FormulaToken) -> str:
    """Return why no phrase begins with `token`."""
    if token.text in {",", "[", "]", "inf"}:
        index = "; a column has no index" if token.text == "[" else ""
        return f"an interval [a,b] or [a,inf) is written right after always, until or another operator over time{index}"
    if token.kind == "end":
        return "the formula is not complete"
    misspelled = token.kind == "word" and token.text not in FORMULA_WORDS
    hint = _meant(token.text, _OPERATORS) if misspelled else ""
    return f"unexpected {token.text!r}{hint and '; ' + hint.strip()}"


def _of_dots(name: str, known: Collection[str]) -> str:
    """Return a question with the column that a name with dots means, whole or from one of its dots on."""
    parts = [re.sub("[^a-z0-9]+", "_", each.lower()).strip("_") for each in name.split(".")]
    for k in range(len(parts)):
        ending = "_".join(parts[k:])
        found = [each for each in known if each == ending or each.endswith(f"_{ending}")]
        if len(found) == 1:
            return f"did you mean {found[0]!r}? "
    return ""


def _meant(word: str, allowed: Collection[str], cutoff: float = 0.6) -> str:
    """Return a question with the nearest of the `allowed` words; empty if none is near."""
    near = _nearest(word, allowed, cutoff)
    return f"did you mean {near!r}? " if near else ""


def _nearest(word: str, allowed: Collection[str], cutoff: float = 0.6) -> str:
    # As `schemas.errors`, which cannot be imported here: the mathematics takes the values of the schemas alone.
    small = {each.lower(): each for each in sorted(allowed)}
    near = difflib.get_close_matches(word.lower(), small, 1, cutoff)
    return small[near[0]] if near else ""
