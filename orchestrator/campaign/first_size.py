"""The size of a first campaign: as large as it may be to run for about a minute."""

from dataclasses import dataclass

SECONDS, WORKERS = 60.0, 2
"""Duration of a first campaign, and the local workers of `perfbound run`."""
LEAST_COST = 0.005
"""Seconds that any rollout costs, with its file and its place in the database."""
FEWEST_TESTS, FEWEST_STARTS = 20, 20


@dataclass(frozen=True, slots=True)
class FirstSize:
    """How many rollouts a first campaign has."""

    max_tests: int
    replicates: int
    """Of each test whose rollouts depend on the seed."""
    spot_check: int = 299
    recheck: int = 20

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
    FirstSize(max_tests=30, replicates=4, spot_check=115, recheck=5)
    """
    full = NOISY if noisy else EXACT
    affordable = SECONDS * WORKERS / max(cost or 0.0, LEAST_COST)
    if affordable >= full.rollouts(variants):
        return full
    half, recheck = int(affordable / 2), 5
    replicates = next((each for each in (8, 4, 2) if each <= full.replicates and _tests(half, each, variants)), 1)
    tests = max(FEWEST_TESTS, min(full.max_tests, half // (replicates * variants)))
    spot_check = max(FEWEST_STARTS, min(full.spot_check, (half - recheck) // variants))
    return FirstSize(tests, replicates, spot_check, recheck)


def _tests(rollouts: int, replicates: int, variants: int) -> bool:
    return rollouts // (replicates * variants) >= FEWEST_TESTS
