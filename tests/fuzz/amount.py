"""How many inputs each border gets; `PERFBOUND_FUZZ` sets it for all of them, and `make fuzz` prints the sum."""

import os
from collections.abc import Iterator

VARIABLE = "PERFBOUND_FUZZ"
CHOSEN = VARIABLE in os.environ
"""Whether an amount was asked for; otherwise every run of the tests has the same few inputs."""
COUNT = int(os.environ.get(VARIABLE, "100"))
"""Inputs of a border that costs little."""
LEAST = 10
_made = 0


def inputs(one_in: int = 1, first: int = 0) -> Iterator[int]:
    """Yield the numbers of the inputs of a border; a costly one has one in so many of the others'."""
    global _made  # noqa: PLW0603  (the sum over all tests of the process)
    for number in range(first, first + max(COUNT // one_in, LEAST)):
        _made += 1
        yield number


def made() -> int:
    """Return the number of inputs that this process has made so far."""
    return _made
