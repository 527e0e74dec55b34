"""What to write in place of text that no formula has, for messages: pure functions of its tokens."""

import difflib
import math
import re
from collections.abc import Collection

from ....schemas.values import FORMULA_WORDS
from .tokens import FormulaToken

__all__ = ["BETWEEN", "COMPARATORS", "UNTIL", "decimal", "function", "surplus", "unexpected", "unit", "unknown"]

COMPARATORS = ("<=", ">=", "<", ">")
UNTIL = ("until", "until_from")
BETWEEN = frozenset({*UNTIL, "and", "or", "implies"})
_OPERATORS = ("always", "eventually", *UNTIL, "not", "and", "or", "implies")
_BEGINNINGS = ("always", "eventually")
_OTHERWISE = {
    "sqrt": "write (f)^0.5",
    "max": "write `f < c and g < c` for `max(f, g) < c`",
    "min": "write `f > c and g > c` for `min(f, g) > c`",
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
    near = f"did you mean {whole!r}? " if whole in (known or ()) else _meant(name, (*_OPERATORS, "abs"), 0.7)
    hint = f"{_OTHERWISE[name]}; " if name in _OTHERWISE else near
    return f"unknown function {name!r}; {hint}the only function is abs"


def unknown(name: str, after: FormulaToken, known: Collection[str]) -> str:
    """Return why `name` is no column."""
    near = _meant(name, {*known, *_BEGINNINGS} if after.text == "[" else known)
    if "." in name:
        near = f"a name has no dot, write _; {_of_dots(name, known) or near}"
    return f"unknown column {name!r}; {near}known are {', '.join(known)}"


def no_operator(name: str) -> str:
    """Return why `name` is no operator."""
    return f"there is no operator {name!r}; {_meant(name, _OPERATORS)}there are {', '.join(_OPERATORS)}"


def surplus(token: FormulaToken) -> str:
    """Return why the text cannot continue with `token`, behind a whole phrase."""
    if token.text in UNTIL:
        return "`until` does not chain: put one of the two into parentheses"
    if token.text in COMPARATORS:
        return "comparisons do not chain: write `a <= b and b <= c`"
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
        return f"an interval [a,b] or [a,inf) is written right after always, eventually or until{index}"
    if token.kind == "end":
        return "the formula is not complete"
    hint = (
        _meant(token.text, FORMULA_WORDS - {"inf"}) if token.kind == "word" and token.text not in FORMULA_WORDS else ""
    )
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
    # As `schemas.errors`, which cannot be imported here: the mathematics takes the values of the schemas alone.
    small = {each.lower(): each for each in sorted(allowed)}
    near = difflib.get_close_matches(word.lower(), small, 1, cutoff)
    return f"did you mean {small[near[0]]!r}? " if near else ""
