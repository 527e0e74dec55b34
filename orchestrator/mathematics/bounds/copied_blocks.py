"""Test that the replicates of a test are independent, and not copies of one another, where outcomes may repeat.

| symbol | name       | meaning                                                                       | shape  |
|--------|------------|-------------------------------------------------------------------------------|--------|
|        | block      | the rollouts of one test; each is known by its class: equal for equal results | (n,)   |
| c_k, N | `counts`   | number of rollouts of class k at a start, and of all of them there            | (K,)   |
| m_j    |            | number of classes with j rollouts                                             |        |
| q      |            | a prediction of classes that expects blocks of copies or of different results |        |
| theta  |            | expected share of blocks that are copies, by the blocks before                | ()     |
| E      | `evidence` | product over starts of q(classes) prod_k c_k! prod_j m_j! / N!, in reverse    | ()     |

Independent rollouts of one law at a start are exchangeable: given how often each result occurs, every order of them is
equally probable. There are N!/(prod c_k! prod m_j!) ways to divide them into unnamed classes of these sizes, so no law
gives the observed one a larger probability than the reciprocal, however many results are possible. A prediction q that
is made before each rollout, divided by it, is therefore at most a likelihood ratio: with independent rollouts its mean
is at most 1 at every moment, for any rule that chose the starts by what came before, and it reaches 1/alpha with
probability at most alpha [Ville]. A result that is frequent costs nothing: it repeats between tests as well.

Only starts with several tests can tell copies from results that repeat.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

LEVEL = 0.01
"""Failure probability of the test."""
SURE = 0.99
"""Of a prediction: that a copy is one, or that a result is new."""
OLD = 0.5
"""Of a prediction: that the first rollout of a block of copies, or one that is none, has a known result."""
LARGEST = 1e12
"""Of the evidence that is reported."""


@dataclass(slots=True)
class CopiedBlocks:
    """The test; `observe` takes the classes of the rollouts of a test in the order of the tests, each once.

    >>> honest, copied = CopiedBlocks(), CopiedBlocks()
    >>> for _ in range(3):
    ...     honest.observe("start", ["fell", "stood", "fell", "stood"])
    >>> for noise in range(3):
    ...     copied.observe("start", [noise] * 4)
    >>> honest.refutes, copied.refutes
    (False, True)
    """

    _counts: dict[Hashable, Counter[Hashable]] = field(default_factory=lambda: defaultdict(Counter))
    _copied: float = 0.5
    _blocks: float = 1.0
    _log: float = 0.0
    _largest: float = 0.0

    @property
    def evidence(self) -> float:
        """E, the largest so far: a refutation is never withdrawn."""
        return min(math.exp(min(self._largest, 700.0)), LARGEST)

    @property
    def refutes(self) -> bool:
        """Whether the results refute that rollouts are independent, at LEVEL."""
        return self._largest >= -math.log(LEVEL)

    def observe(self, start: Hashable, block: Sequence[Hashable]) -> None:
        """Take the results of a test at a start."""
        if len(block) < 2:
            return  # nothing to be a copy of
        counts, theta = self._counts[start], self._copied / self._blocks
        before = _log_ways(counts)
        copies, different = _copies(counts, block), _different(counts, block)
        counts.update(block)
        likelier = max(copies, different)
        mixed = theta * math.exp(copies - likelier) + (1.0 - theta) * math.exp(different - likelier)
        self._log += likelier + math.log(mixed) + _log_ways(counts) - before
        self._largest = max(self._largest, self._log)
        # Krichevsky and Trofimov's estimate, by what the block most probably is.
        self._copied += theta * math.exp(copies - likelier) / mixed
        self._blocks += 1.0


def _log_ways(counts: Counter[Hashable]) -> float:
    """Return the logarithm of the number of divisions into unnamed classes of these sizes."""
    sizes = Counter(counts.values())
    named = math.lgamma(counts.total() + 1) - sum(math.lgamma(size + 1) for size in counts.values())
    return named - sum(math.lgamma(number + 1) for number in sizes.values())


def _copies(counts: Counter[Hashable], block: Sequence[Hashable]) -> float:
    """Return the logarithm of what is predicted of a block of copies."""
    first, *others = block
    found = _one(counts, first, new=1.0 - OLD)
    seen = counts + Counter([first])
    for each in others:
        found += math.log(SURE) if each == first else math.log(1.0 - SURE) + _one(seen, each, new=1.0 - OLD)
        seen[each] += 1
    return found


def _different(counts: Counter[Hashable], block: Sequence[Hashable]) -> float:
    """Return the logarithm of what is predicted of a block of different results."""
    seen, found = counts.copy(), 0.0
    for each in block:
        found += _one(seen, each, new=SURE)
        seen[each] += 1
    return found


def _one(seen: Counter[Hashable], result: Hashable, *, new: float) -> float:
    """Return the logarithm of the predicted probability of a class: a new one, or one by its frequency."""
    if not seen:
        return 0.0
    return math.log(new) if result not in seen else math.log1p(-new) + math.log(seen[result] / seen.total())
