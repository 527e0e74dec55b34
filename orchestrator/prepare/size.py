"""The size of a first campaign: as large as it may be to run for about a minute."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...schemas.ranges import LARGEST_BATCH
from ...schemas.values import Guess

if TYPE_CHECKING:
    from ..campaign.plan import ProblemPlan

SECONDS, WORKERS = 60.0, 2
"""Duration of a first campaign, and the local workers of `perfbound run`."""
LEAST_COST = 0.005
"""Seconds that any rollout costs, with its file and its place in the database."""
FEWEST_TESTS, FEWEST_STARTS = 20, 20
RECHECK = 20
PER_SECOND = 120.0
"""Rollouts that the orchestrator records, whatever the workers can do."""
FEWEST_SAMPLES, MOST_SAMPLES = 59, 2995
"""Samples without a violation that show at most 5 % and .1 %, at 95 %."""

BATCH_BYTES = 8 * 2**20
"""Of a larger batch the costs besides its rollouts have long been shared."""
LONG = 0.05
"""Seconds of a rollout from which its costs besides the simulation, some 10 ms, are not worth a batch."""
BATCHES = 4
"""Batches of each worker at least, so that none is idle while another one simulates the last."""
BATCH_SECONDS = 0.25
"""Duration of a batch: a hundred times what it costs besides its rollouts, and a campaign still ends when it should."""


@dataclass(frozen=True, slots=True)
class FirstSize:
    """How many rollouts a first campaign has."""

    max_tests: int
    replicates: int
    """Of each test whose rollouts depend on the seed."""
    spot_check: int = 299
    recheck: int = RECHECK

    def rollouts(self, variants: int) -> int:
        """Return the largest number of rollouts, with `variants` rollouts for each replicate of a test."""
        return self.max_tests * self.replicates * variants + self.spot_check * variants + self.recheck


NOISY, EXACT = FirstSize(60, 8), FirstSize(100, 1)
"""Of campaigns whose rollouts cost little."""


def first_size(cost: float | None, *, noisy: bool, variants: int) -> FirstSize:
    """Return the size for rollouts that take `cost` seconds each; None if that is not known.

    >>> first_size(0.001, noisy=True, variants=1) == NOISY
    True
    >>> first_size(0.5, noisy=True, variants=1)
    FirstSize(max_tests=110, replicates=1, spot_check=110, recheck=20)
    """
    full = NOISY if noisy else EXACT
    affordable = SECONDS * WORKERS / max(cost or 0.0, LEAST_COST)
    if affordable >= full.rollouts(variants):
        return full
    # Where rollouts are dear, another start shows more than another rollout at the same one.
    half = int((affordable - full.recheck) / 2) // variants
    tests = max(FEWEST_TESTS, min(full.max_tests * full.replicates, half))
    return FirstSize(tests, 1, max(FEWEST_STARTS, min(full.spot_check, half)))


def growing_time(seconds: float, tried: int, tests: float) -> Guess:
    """Return the time of the mathematics of so many tests; a test takes as long as those that were tried, or longer.

    >>> growing_time(2.0, 100, 200)
    Guess(middle=6.0, low=4.0, high=8.0)
    """
    share = tests / tried
    low, high = sorted((seconds * share, seconds * share**2))
    return Guess((low + high) / 2, low, high)


def first_samples(cost: float | None) -> FirstSize:
    """Return the size of a campaign of drawn starts, of two digits, for rollouts that take `cost` seconds each.

    >>> [first_samples(cost).max_tests for cost in (0.001, 0.07, 0.5, 5.0)]
    [2995, 1700, 220, 59]
    """
    rate = min(PER_SECOND, WORKERS / max(cost or 0.0, LEAST_COST))
    affordable = float(f"{max(SECONDS * rate - RECHECK, 0.0):.2g}")
    return FirstSize(int(min(max(affordable, FEWEST_SAMPLES), MOST_SAMPLES)), 1)


def proposed_batch(seconds: float, size: float, rollouts: float = math.inf, workers: int = WORKERS) -> int:
    """Return the key `batch` for rollouts that take so long in a batch, and so many bytes; a power of two.

    `rollouts` are those whose starts no rollout decides: all of a problem, or those of a test where each is decided by
    the tests before it. It is 1 where a batch would not pay, or would leave workers idle.

    >>> proposed_batch(0.001, 4000), proposed_batch(0.1, 4000), proposed_batch(1e-5, 100_000)
    (128, 1, 64)
    >>> proposed_batch(1e-5, 4000, rollouts=2995, workers=2), proposed_batch(1e-5, 4000, rollouts=8)
    (256, 1)
    """
    if seconds > LONG:
        return 1
    fewest = BATCHES * workers
    most = min(BATCH_SECONDS / max(seconds, 1e-9), BATCH_BYTES / max(size, 1), LARGEST_BATCH, rollouts / fewest)
    return 1 << int(math.log2(max(most, 1.0)))


def undecided_rollouts(plans: Iterable["ProblemPlan"]) -> int:
    """Return the rollouts of a problem whose starts no rollout decides, of the problem that has most of them."""
    return max(len(each.rollouts) * (each.budget if each.is_planned else 1) for each in plans)
