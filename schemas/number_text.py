"""One number in a text from outside: what CSV files of people, programs and languages contain."""

import re

_NUMBER = re.compile(
    r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?|[+-]?(?:inf|infinity|nan)", re.ASCII | re.I
)


def number_in(text: str) -> float:
    """Return the number that a text is, with spaces around it or not; Fortran writes exponents with a D.

    Python's `float` takes `1_000` and digits of other scripts as well: those are slips.

    Raises:
        ValueError: it is none.

    >>> number_in(" 2.5"), number_in("1.0D-01")
    (2.5, 0.1)
    >>> number_in("1_000")
    Traceback (most recent call last):
        ...
    ValueError: '1_000' is no number

    """
    found = text.strip()
    if not _NUMBER.fullmatch(found):
        raise ValueError(f"{found[:40]!r} is no number")
    lower = found.lower()
    return float(lower if "n" in lower else lower.replace("d", "e"))
