"""Amounts as text: numbers of bytes and of things."""

import math
import re
from collections.abc import Sequence

UNITS = {"h": 3600.0, "d": 86_400.0, "w": 604_800.0}
"""Seconds of the units of an age."""


def seconds_of(age: str) -> float:
    """Return an age with its unit in s.

    Raises:
        ValueError: it is none.

    >>> seconds_of("36h"), seconds_of("30d")
    (129600.0, 2592000.0)

    """
    found = re.fullmatch(r"([0-9]{1,6})\s*([hdw])", age.strip())
    if found is None:
        raise ValueError('allowed is a number with a unit: "36h", "30d" or "2w"')
    return int(found[1]) * UNITS[found[2]]


def amount(number: float) -> str:
    """Return a number of bytes.

    >>> amount(1488), amount(97_095_680), amount(2.5e12)
    ('1.49 kB', '97.1 MB', '2.5 TB')
    """
    power = min(4, int(math.log10(number) // 3)) if number >= 1 else 0
    return f"{number / 1000**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"


MOST_NUMBERS, SHOWN = 24, 6
"""Of a start in words: with more numbers the first ones are shown."""


def some_of(parts: Sequence[str]) -> str:
    """Return the numbers of a start in words; of many the first ones.

    >>> some_of(["gap = 5 m", "mass = 2 kg"]), some_of(["0"] * 1000)
    ('gap = 5 m, mass = 2 kg', '0, 0, 0, 0, 0, 0, and 994 further numbers')
    """
    shown = parts if len(parts) <= MOST_NUMBERS else parts[:SHOWN]
    more = [f"and {len(parts) - SHOWN:,} further numbers"] if len(parts) > MOST_NUMBERS else []
    return ", ".join([*shown, *more])


def counted(number: int, noun: str) -> str:
    """Return a number with its noun.

    >>> counted(1, "rollout"), counted(100_000, "rollout"), counted(2, "batch")
    ('1 rollout', '100,000 rollouts', '2 batches')
    """
    plural = "es" if noun.endswith("ch") else "s"
    return f"{number:,} {noun}{'' if number == 1 else plural}"
