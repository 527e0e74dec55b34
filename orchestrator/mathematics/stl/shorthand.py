"""The spelling of other tools: `G[0,30] (x < 1)` as this grammar has it, for messages.

The grammar itself has one spelling: a column may be called G, F or U, and a certificate prints its formula as it was
written.
"""

import re
from collections.abc import Collection
from typing import NamedTuple

__all__ = ["Spelling", "spelled_out"]

_WORDS = {
    "G": "always",
    "F": "eventually",
    "U": "until",
    "alw": "always",
    "ev": "eventually",
    "globally": "always",
    "finally": "eventually",
    "always": "always",  # always_[0,1]
    "eventually": "eventually",
    "until": "until",
}
_SIGNS = {
    "&&": "and",
    "&": "and",
    "\u2227": "and",
    "||": "or",
    "|": "or",
    "\u2228": "or",
    "->": "implies",
    "=>": "implies",
    "\u2192": "implies",
    "\u21d2": "implies",
    "!": "not",
    "~": "not",
    "\u00ac": "not",
    "\u25a1": "always",
    "\u25c7": "eventually",
    "\u2264": "<=",
    "\u2265": ">=",
}
_OTHER = re.compile(
    # A word is an operator only before what it applies to: `G - x` subtracts from a column.
    rf"""\b(?P<word>{"|".join(_WORDS)})(?P<mark>_?)(?=(?P<phrase>\s*[\[(])|\s+\w|\s*[!~\u00ac])
       |(?P<sign>&&?|\|\|?|->|(?<!<)=>|!(?!=)|[~\u2227\u2228\u2192\u21d2\u00ac\u25a1\u25c7\u2264\u2265])""",
    re.VERBOSE,
)


class Spelling(NamedTuple):
    """A formula in the words of the grammar, and the first place where it was written otherwise."""

    text: str
    position: int
    length: int


def spelled_out(text: str, known: Collection[str] | None) -> Spelling | None:
    """Return `text` with the words of the grammar in place of those of other tools; None if it has none of those.

    The result may be no formula: whether it is one only the parser knows.

    >>> spelled_out("G_[0,30] (x < 1 -> F[0,2] !(y > 0))", None)
    Spelling(text='always[0,30] (x < 1 implies eventually[0,2] not (y > 0))', position=0, length=2)
    >>> spelled_out("always (G < 1 and G - F > 2)", ["G", "F"])

    """
    places = []

    def word(match: re.Match[str]) -> str:
        if match["sign"]:
            found = f" {_SIGNS[match['sign']]} "
        elif match["word"] in (known or ()) and not match["phrase"]:
            found = match[0]
        else:
            found = _WORDS[match["word"]]
        if found != match[0]:
            places.append(match.span())
        return found

    spelled = " ".join(_OTHER.sub(word, text).split()).replace("( ", "(").replace(" )", ")")
    return Spelling(spelled, places[0][0], places[0][1] - places[0][0]) if places else None
