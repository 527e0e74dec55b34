"""Amounts as text: numbers of bytes and of things."""

import math
from collections.abc import Sequence


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
