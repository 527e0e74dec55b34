"""Facts of a sentence: keys, numbers, units, names and signs that it has to have in this order, whatever its wording.

Its wording is in `tests/texts`. `match=facts("c.toml: space.gap.low: 60 high = 5")` is for `pytest.raises`.
"""

import re


def facts(listed: str) -> str:
    """Return a regular expression for a text that has the facts, which blanks separate, as whole words in their order.

    A first fact that begins with ^ is at the beginning of the text.

    >>> says("space.gap.low: 60 must be less than high = 5", "^space.gap.low: 60 < high = 5")
    False
    >>> says("space.gap.low: 60 must be less than high = 5", "^space.gap.low: 60 less high = 5")
    True
    >>> says("at most 2.5 m", "5 m"), says("at most 2.5 m", "2.5 mm"), says("the bound is 0.3 m.", "0.3 m")
    (False, False, True)
    """
    found = listed.split()
    assert found, "a text has facts"
    anchor = r"\A" if found[0][0] == "^" else ""
    return f"(?s){anchor}{'.*?'.join(map(_whole, [found[0].removeprefix('^'), *found[1:]]))}"


def says(text: str, listed: str) -> bool:
    """Whether a text has the facts."""
    return re.search(facts(listed), text) is not None


def _whole(fact: str) -> str:
    before = r"(?<![\w.])" if fact[0].isdigit() else r"(?<!\w)" if fact[0].isalpha() else ""
    after = r"(?!\w|\.\d)" if fact[-1].isalnum() else ""
    return before + re.escape(fact) + after
