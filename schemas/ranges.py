"""The range of every number that crosses a border: the same on the wire, in the database and on the page.

SQLite stores integers of 64 bits, and JavaScript keeps them exactly up to 2^53. Floats have a range of their own, so
that sums and squares of many stay finite.
"""

from typing import Annotated

from pydantic import Field

SEED_BITS = 53
"""Of the largest seed, so that every JSON reader keeps it exactly."""
LARGEST_INTEGER = 2**53 - 1
MAX_FILE_BYTES = 64 * 2**20
"""Of a trajectory's file; a 15 s rollout of nine columns takes 0.2 MB."""
MOST_SECONDS = 1e9
"""Thirty years; a million attempts of them sum up to 1e15 s, still exact to a second."""
LARGEST_NUMBER = 1e100
LARGEST_BATCH = 1024
"""Rollouts of a batch: beyond it the cost of a rollout does not fall any more."""
DIGEST = 32
"""Bytes of a sha256."""

ProtocolNumber = Annotated[int, Field(ge=0, le=10**6)]
ProcessId = Annotated[int, Field(ge=1, lt=2**31, description="as the kernel counts them: pid_t has 32 bits")]
TestNumber = Annotated[int, Field(ge=0, lt=10**9)]
ReplicateNumber = Annotated[int, Field(ge=0, lt=10**6)]
AttemptNumber = Annotated[int, Field(ge=1, le=10**6)]
Seed = Annotated[int, Field(ge=0, lt=2**SEED_BITS)]
SeedBits = Annotated[int, Field(ge=31, le=SEED_BITS)]
StepCount = Annotated[int, Field(ge=0, le=LARGEST_INTEGER)]
FileBytes = Annotated[int, Field(ge=1, le=MAX_FILE_BYTES)]
Seconds = Annotated[float, Field(ge=0, le=MOST_SECONDS)]
Magnitude = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
"""A component of a starting condition, its limits, or an option, in a unit of the system's choice."""


def within_steps(count: float) -> int:
    """Return a count of steps as a system gives it, in the range of a message.

    >>> within_steps(7), within_steps(-1), within_steps(2**63), within_steps(2.5), within_steps(float("nan"))
    (7, 0, 9007199254740991, 2, 0)
    """
    return int(min(max(0, count), LARGEST_INTEGER)) if count == count else 0  # noqa: PLR0124  (not a number)


def within_seconds(seconds: float) -> float:
    """Return a duration that a database has, in the range of a message.

    >>> within_seconds(1.5), within_seconds(1.5e308)
    (1.5, 1000000000.0)
    """
    return min(max(0.0, seconds), MOST_SECONDS)
