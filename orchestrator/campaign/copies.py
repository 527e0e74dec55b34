"""Copies among the rollouts of a problem: trajectories that agree bit by bit although their seeds differ.

Equal trajectories alone are no fault: a margin that saturates, a rare failure or a start without noise gives them as
well, of independent rollouts. These repeat between the tests of a start as often as within them; copies repeat within.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass

from ...schemas.ids import RolloutId
from ..mathematics.bounds.checks.copied_blocks import CopiedBlocks
from .series import Account

MOST = 200
"""Pairs of trajectories that are compared."""
MOST_FILES = 2000
"""Trajectories that `tested_copies` reads; those of a margin with two values are all alike."""

Digest = Callable[[RolloutId], bytes]
"""Returns the digest of the samples of an observed rollout, which two share if they agree in every bit."""


@dataclass(frozen=True, slots=True)
class TestedCopies:
    """Whether rollouts of a test are copies: the evidence, and whether no two of any test differ."""

    evidence: float
    refuted: bool
    all_alike: bool | None
    """None where every test has one rollout, so that nothing was tested."""


def copies(account: Account, noisy: Set[str], digest: Digest) -> tuple[int, int]:
    """Return how many pairs of rollouts at one start were compared, and how many of them agree bit by bit.

    `noisy` are the variants of the problem that depend on the seed. Copies have equal values, so the files of all other
    rollouts need not be read.
    """
    is_drawn = account.plan.candidates is None  # each start is that of one test
    if is_drawn and account.plan.replicates == 1:
        return 0, 0
    seen: dict[tuple[int, float], RolloutId] = {}
    compared = found = 0
    for node, values, rollouts in _closed_tests(account, noisy):
        for value, rollout in zip(values, rollouts, strict=True):
            earlier = seen.setdefault((node, value), rollout)
            if earlier != rollout:
                compared += 1
                found += digest(earlier) == digest(rollout)
            if compared == MOST:
                return compared, found
        if is_drawn:
            seen.clear()
    return compared, found


def tested_copies(account: Account, noisy: Set[str], digest: Digest) -> TestedCopies:
    """Test that rollouts differ as much within tests as between those of one start, in the order of the tests."""
    test, read, alike = CopiedBlocks(), 0, list[bool]()
    often = Counter((node, value) for node, values, _ in _closed_tests(account, noisy) for value in values)
    for node, values, rollouts in _closed_tests(account, noisy):
        if read >= MOST_FILES:
            break  # by the tests before: no test is left out for what it shows
        block = []
        for value, rollout in zip(values, rollouts, strict=True):
            repeated = often[node, value] > 1
            read += repeated
            block.append((value, digest(rollout).hex() if repeated else ""))
        if len(block) > 1:
            alike.append(len(set(block)) == 1)
        test.observe(node, block)
    return TestedCopies(test.evidence, test.refutes, all(alike) if alike else None)


def _closed_tests(account: Account, noisy: Set[str]) -> Iterator[tuple[int, tuple[float, ...], list[RolloutId]]]:
    """Yield start, values and rollouts of every closed test."""
    plan, variant = account.plan, max(noisy)
    for test, (node, each) in enumerate(zip(account.nodes, account.each, strict=True)):
        values = each[: plan.replicates]
        numbers = range(len(values))
        yield node, values, [RolloutId(plan.name, test, *plan.replicate(variant, number)) for number in numbers]
