"""The durations of the commits of a campaign database since its journal was opened, counted in buckets."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

EDGES = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
"""Upper edges of the buckets in s, each part of its bucket; a last bucket has everything that takes longer."""


@dataclass(frozen=True, slots=True)
class CommitTimes:
    """How long commits took: their numbers by bucket, one more than `EDGES`, and the sum in s."""

    numbers: tuple[int, ...] = (0,) * (len(EDGES) + 1)
    seconds: float = 0.0

    def with_one(self, seconds: float) -> "CommitTimes":
        """Return these times with one commit more.

        >>> CommitTimes().with_one(0.001).with_one(0.0011).with_one(60.0).numbers
        (0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1)
        """
        place = bisect_left(EDGES, seconds)
        numbers = (*self.numbers[:place], self.numbers[place] + 1, *self.numbers[place + 1 :])
        return CommitTimes(numbers, self.seconds + seconds)


def cumulative(numbers: Sequence[int]) -> tuple[int, ...]:
    """Return for each bucket the number of commits in it and in all before it.

    >>> cumulative((1, 0, 2))
    (1, 1, 3)
    """
    return tuple(sum(numbers[: place + 1]) for place in range(len(numbers)))
