"""Test that the replicates of a test are independent, and not copies of one another, where outcomes may repeat.

| symbol | name       | meaning                                                                       | shape  |
|--------|------------|-------------------------------------------------------------------------------|--------|
|        | block      | the rollouts of one test; each is known by its class: equal for equal results | (n,)   |
| c_k    | `counts`   | number of rollouts of class k at a start, classes in the order of appearance  | (K,)   |
| p_k    |            | probability of class k                                                        | (K,)   |
| v_k    |            | p_k/(1 - p_1 - .. - p_(k-1))                                                  | (K,)   |
| a, b   |            | c_k - 1, and the sum of c_j over j > k                                        | ()     |
| q      |            | a prediction of classes that expects blocks of copies or of different results |        |
| theta  |            | expected share of blocks that are copies, by the blocks before                | ()     |
| eta    |            | expected share of rollouts that agree with the first of their block           | ()     |
| E      | `evidence` | product over starts of q(classes) prod_k (a + b)^(a + b)/(a^a b^b)            | ()     |

Independent rollouts of one law at a start: given all before it, a rollout is of class k with probability p_k, and of a
new one with 1 - p_1 - .. - p_K, whatever its value then is. A prediction q made before each rollout, divided by these
probabilities, is a martingale of mean 1 whatever rule chooses starts and the end by the values themselves. The
probabilities of all rollouts at a start multiply to prod_k v_k^a (1 - v_k)^b, which no law makes larger than
prod_k a^a b^b/(a + b)^(a + b). So E is at most this martingale for every law, and reaches 1/alpha with probability at
most alpha [Ville]. A result that is frequent costs nothing: it repeats between tests as well.

Only starts with several tests can tell copies from results that repeat.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...gp.kernels import Floats

LEVEL = 0.01
"""Failure probability of the test."""
NEW = 0.99
"""Of the prediction of different results: that the next one is new."""
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
    _agreed: float = 0.5
    _pairs: float = 1.0
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
        before = _least_surprise(counts)
        copies, different = _copies(counts, block, self._agreed / self._pairs), _different(counts, block)
        counts.update(block)
        likelier = max(copies, different)
        mixed = theta * math.exp(copies - likelier) + (1.0 - theta) * math.exp(different - likelier)
        self._log += likelier + math.log(mixed) + _least_surprise(counts) - before
        self._largest = max(self._largest, self._log)
        # Krichevsky and Trofimov's estimates; a block counts as what it most probably is.
        self._copied += theta * math.exp(copies - likelier) / mixed
        self._blocks += 1.0
        self._agreed += sum(each == block[0] for each in block[1:])
        self._pairs += len(block) - 1


def _least_surprise(counts: Counter[Hashable]) -> float:
    """Return minus the logarithm of the largest probability that a law gives to these classes in their order.

    The keys of a counter are in the order in which they appeared.
    """
    each = np.fromiter(counts.values(), float, len(counts))
    a, b = each - 1.0, each.sum() - np.cumsum(each)
    return float(np.sum(_xlogx(a + b) - _xlogx(a) - _xlogx(b)))


def _xlogx(x: Floats) -> Floats:
    return np.asarray(x * np.log(np.maximum(x, 1.0)))  # of whole numbers; 0 for 0


def _copies(counts: Counter[Hashable], block: Sequence[Hashable], eta: float) -> float:
    """Return the logarithm of what is predicted of a block of copies."""
    first, *others = block
    found = _one(counts, first, new=1.0 - OLD)
    seen = counts + Counter([first])
    for each in others:
        found += math.log(eta) if each == first else math.log1p(-eta) + _one(seen, each, new=1.0 - OLD)
        seen[each] += 1
    return found


def _different(counts: Counter[Hashable], block: Sequence[Hashable]) -> float:
    """Return the logarithm of what is predicted of a block of different results."""
    seen, found = counts.copy(), 0.0
    for each in block:
        found += _one(seen, each, new=NEW)
        seen[each] += 1
    return found


def _one(seen: Counter[Hashable], result: Hashable, *, new: float) -> float:
    """Return the logarithm of the predicted probability of a class: a new one, or one by its frequency."""
    if not seen:
        return 0.0
    return math.log(new) if result not in seen else math.log1p(-new) + math.log(seen[result] / seen.total())
