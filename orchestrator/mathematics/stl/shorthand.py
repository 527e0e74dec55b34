"""The spelling of other tools and keyboards: `G[0,30] (x < 1)` as this grammar has it, for messages.

The grammar itself has one spelling: a column may be called G, F or U, and a certificate prints its formula as it was
written.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

from ....schemas.values import FORMULA_WORDS

__all__ = ["Spelling", "spelled_out"]

_WORDS = {
    "G": "always",
    "F": "eventually",
    "U": "until",
    "alw": "always",
    "ev": "eventually",
    "globally": "always",
    "finally": "eventually",
    "S": "since",
    "O": "once",
    "P": "once",
    "H": "historically",
    "hist": "historically",
    "X": "next",
    "Y": "previous",
    "prev": "previous",
    "yesterday": "previous",
    "rose": "rise",
    "fell": "fall",
    "ln": "log",
    "always": "always",  # always_[0,1]
    "eventually": "eventually",
    "until": "until",
    "since": "since",
    "once": "once",
    "historically": "historically",
}
_SIGNS = {
    "&&": " and ",
    "&": " and ",
    "/\\": " and ",
    "\u2227": " and ",
    "||": " or ",
    "|": " or ",
    "\\/": " or ",
    "\u2228": " or ",
    "-->": " implies ",
    "->": " implies ",
    "==>": " implies ",
    "=>": " implies ",
    "\u2192": " implies ",
    "\u21d2": " implies ",
    "!": " not ",
    "~": " not ",
    "\u00ac": " not ",
    "\u25a1": " always ",
    "\u25c7": " eventually ",
    "\u25cb": " next ",
    "\u2260": " != ",
    "~=": " != ",
    "<>": " != ",
    "\u2264": " <= ",
    "\u2265": " >= ",
    "=<": " <= ",
    "< =": " <= ",
    "> =": " >= ",
    "**": "^",
    "\u00b2": "^2",
    "\u00b3": "^3",
    "\u00b7": "*",
    "\u00d7": "*",
    "\u2212": "-",
    "\u2013": "-",
    "{": "(",
    "}": ")",
    **dict.fromkeys("\u00a0\u2009\u202f", " "),
    **dict.fromkeys('"`\u2018\u2019\u201c\u201d\u201e', ""),
}
_READINGS: tuple[Mapping[str, str], ...] = ({}, {"=>": " >= "})
"""Signs with two meanings, of which one gives a formula."""
_NOT_BEFORE = {"!": "(?!=)", "~": "(?!=)"}
_NOT_BEHIND = {"=>": "(?<![<>])"}
_SIGN = "|".join(
    _NOT_BEHIND.get(sign, "") + re.escape(sign) + _NOT_BEFORE.get(sign, "")
    for sign in sorted(_SIGNS, key=len, reverse=True)
)
_TIMED = re.compile(rf"\b({'|'.join(_WORDS)}|until_from)_?\s*$")
_SECONDS = r"\d+(?:\.\d*)?|\.\d+"
_OTHER = re.compile(
    # A word is an operator only before what it applies to: `G - x` subtracts from a column.
    rf"""\b(?P<word>{"|".join(_WORDS)})(?P<mark>_?)(?=(?P<phrase>\s*[\[(])|\s+\w|\s*[!~\u00ac])
       |\b(?P<cased>(?i:{"|".join(sorted({*FORMULA_WORDS, "globally", "finally"}))}))\b
       |(?P<interval>[\[(]\s*(?P<low>{_SECONDS})\s*[,:;]\s*(?P<high>{_SECONDS}|inf)\s*[\])])
       |(?<!\|)\|(?P<size>[^|<>=\u2264\u2265]+)\|(?!\|)
       |(?P<sign>{_SIGN})""",
    re.VERBOSE,
)


class Spelling(NamedTuple):
    """A formula in the words of the grammar, and the first place where it was written otherwise."""

    text: str
    position: int
    length: int


def spelled_out(text: str, known: Collection[str] | None) -> Iterator[Spelling]:
    """Yield `text` with the words of the grammar in place of others, for each reading; nothing if it has no others.

    The results may be no formulas: whether they are only the parser knows.

    >>> next(spelled_out("G_[0,30] (x < 1 -> F[0,2] !(y > 0))", None))
    Spelling(text='always[0,30] (x < 1 implies eventually[0,2] not (y > 0))', position=0, length=2)
    >>> [each.text for each in spelled_out("x => 2", None)]
    ['x implies 2', 'x >= 2']
    >>> list(spelled_out("always (G < 1 and G - F > 2)", ["G", "F"]))
    []

    """
    for reading in _READINGS:
        if all(sign in text for sign in reading) and (spelling := _spelled(text, known or (), reading)):
            yield spelling


def _spelled(text: str, known: Collection[str], reading: Mapping[str, str]) -> Spelling | None:
    places = []

    def word(match: re.Match[str]) -> str:
        found = match[0]
        if match["sign"]:
            found = {**_SIGNS, **reading}[found]
        elif match["size"]:
            found = f"abs({match['size'].strip()})"
        elif match["interval"]:
            # `f(0:5)` is no interval.
            if _TIMED.search(match.string[: match.start()]) and "," not in found:
                found = f"{found[0]}{match['low']},{match['high']}{')' if match['high'] == 'inf' else found[-1]}"
        elif found not in known or match["phrase"]:
            found = _WORDS.get(match["word"] or found, found.lower())
            found = _WORDS.get(found, found)
        if found != match[0]:
            places.append(match.span())
        return found

    spelled = " ".join(_OTHER.sub(word, text).split()).replace("( ", "(").replace(" )", ")")
    return Spelling(spelled, places[0][0], places[0][1] - places[0][0]) if places else None
