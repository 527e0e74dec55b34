"""The nearest of the allowed names, for one that is not allowed."""

from collections.abc import Iterable


def nearest_name(given: str, allowed: Iterable[str]) -> str:
    """Return the one of the `allowed` names that is nearest to a misspelt one; empty if none is near.

    >>> nearest_name("Horizont", ["horizon", "seed"]), nearest_name("wind", ["gains"])
    ('horizon', '')
    """
    import difflib  # noqa: PLC0415  (late: only a mistake needs it)

    small = {each.lower(): each for each in allowed}
    near = difflib.get_close_matches(given.lower(), small, 1)
    return small[near[0]] if near else ""


def meant(given: str, allowed: Iterable[str]) -> str:
    """Return the question that a message has before the allowed names: `did you mean 'NAME'? `, or nothing."""
    near = nearest_name(given, allowed)
    return f"did you mean {near!r}? " if near else ""
