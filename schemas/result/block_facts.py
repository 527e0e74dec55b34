"""The facts of blocks: of consecutive tests that are proposed, simulated in batches, and observed together.

Each is one fact for up to 1,024 rollouts, in columns: little-endian bytes of numpy arrays, so that neither the journal
nor the hash chain handles them one by one. Rollouts are in the order of the tests, and within one of the replicates.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base import canonical_json
from ..batch import batch_rollouts
from ..ids import RolloutId, rollout_at
from ..ranges import DIGEST
from ..values import Observation, Proposal
from .facts import DiscardFact, Fact, ObservationFact, ProposalFact, RolloutFact

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Marks = NDArray[np.bool_]


def column(values: object, kind: str = "<f8") -> bytes:
    """Return numbers as the bytes of a column."""
    return np.ascontiguousarray(values, dtype=kind).tobytes()


@dataclass(frozen=True, slots=True)
class BlockProposalFact:
    """z of each test of a block; `test` is the first of them."""

    problem: str
    test: int
    node_column: bytes
    x_column: bytes

    @classmethod
    def of(cls, problem: str, test: int, nodes: Integers, x: Floats) -> "BlockProposalFact":
        """Return the fact of `nodes` (k,) and starts `x` (k, p)."""
        return cls(problem, test, column(nodes, "<i8"), column(x))

    def __len__(self) -> int:
        return len(self.node_column) // 8

    @property
    def nodes(self) -> Integers:
        """The number of each start, shape (k,)."""
        return np.frombuffer(self.node_column, dtype="<i8")

    @property
    def x(self) -> Floats:
        """The start of each test, shape (k, p)."""
        return np.frombuffer(self.x_column).reshape(len(self), -1)

    def of_test(self, test: int) -> ProposalFact:
        """Return the proposal of one test of the block; raises IndexError for another one."""
        place = range(len(self))[test - self.test]
        chosen = Proposal(int(self.nodes[place]), tuple(self.x[place].tolist()), None, None, None, None)
        return ProposalFact(self.problem, test, chosen)

    def each(self) -> Iterator[ProposalFact]:
        """Yield the proposal of each test."""
        pairs = zip(self.nodes.tolist(), self.x.tolist(), strict=True)
        for test, (node, x) in enumerate(pairs, start=self.test):
            yield ProposalFact(self.problem, test, Proposal(node, tuple(x), None, None, None, None))


@dataclass(frozen=True, slots=True)
class BatchFact:
    """The trajectories of a batch, durable in one file; `rollout` is the first of them.

    `robustness_column` is empty where a campaign measures none, and has NaN for a rollout that failed.
    `tolerance_column` and `ended_column` are empty where they would have no entry.
    """

    rollout: RolloutId
    block: int
    """The first test of the block that it belongs to."""
    replicates: int
    """Of each test."""
    sha256: str
    """Of the file."""
    size: int
    path: str
    seed_column: bytes
    digest_column: bytes
    robustness_column: bytes = b""
    tolerance_column: bytes = b""
    """Whether the tolerance around time stamps could decide a sign: a byte for each rollout."""
    ended_column: bytes = b""
    """s at which a rollout ended before the horizon; NaN for one that did not."""
    kept_column: bytes = b""
    """Whether the samples of a rollout are in the file, a byte for each; empty where all of them are."""
    failures: tuple[tuple[int, str], ...] = ()
    """Place and reason of each rollout that has failed, in their order."""

    def __len__(self) -> int:
        return len(self.seed_column) // 8

    @property
    def tests(self) -> range:
        """The tests that it has rollouts of."""
        return range(self.rollout.test, self.rollout.test + len(self) // self.replicates)

    @property
    def rollouts(self) -> list[RolloutId]:
        """Every rollout, in their order."""
        return batch_rollouts(self.rollout, len(self) // self.replicates, self.replicates)

    def place(self, rollout: RolloutId) -> int:
        """Return the place of one of its rollouts."""
        return (rollout.test - self.rollout.test) * self.replicates + rollout.replicate - self.rollout.replicate

    @property
    def failed(self) -> tuple[RolloutId, ...]:
        """The rollouts that have no trajectory."""
        rollouts = self.rollouts if self.failures else []
        return tuple(rollouts[place] for place, _ in self.failures)

    @property
    def seeds(self) -> NDArray[np.uint64]:
        """The seed of each rollout, shape (R,)."""
        return np.frombuffer(self.seed_column, dtype="<u8")

    @property
    def digests(self) -> NDArray[np.uint8]:
        """The digest of each rollout, shape (R, 32), see `Batch.digests`; zeros for one that has failed."""
        return np.frombuffer(self.digest_column, dtype=np.uint8).reshape(-1, DIGEST)

    @property
    def robustness(self) -> Floats | None:
        """The robustness of each rollout, shape (R,), NaN for a failed one; None where a campaign measures none."""
        return np.frombuffer(self.robustness_column) if self.robustness_column else None

    @property
    def by_tolerance(self) -> Marks:
        """Whether the tolerance around time stamps could decide a sign, shape (R,)."""
        if not self.tolerance_column:
            return np.zeros(len(self), dtype=np.bool_)
        return np.frombuffer(self.tolerance_column, dtype=np.bool_)

    @property
    def ended(self) -> Floats:
        """When each rollout ended before the horizon, in s, shape (R,); NaN for one that did not."""
        return np.frombuffer(self.ended_column) if self.ended_column else np.full(len(self), np.nan)

    @property
    def kept(self) -> list[int] | None:
        """The places of the rollouts whose samples are in the file; None where all of them are."""
        return np.flatnonzero(np.frombuffer(self.kept_column, np.bool_)).tolist() if self.kept_column else None

    @property
    def succeeded(self) -> Marks:
        """Whether each rollout has a trajectory, shape (R,)."""
        found = np.ones(len(self), dtype=np.bool_)
        found[[place for place, _ in self.failures]] = False
        return found

    def each(self, places: Iterable[int] | None = None) -> Iterator[RolloutFact]:
        """Yield the fact of each rollout that has a trajectory; its sha256 is the digest of the rollout alone.

        With `places` of the rollouts in these places alone.
        """
        robustness = None if self.robustness is None else self.robustness.tolist()
        tolerance, ended = self.by_tolerance.tolist(), self.ended.tolist()
        seeds, succeeded, digests = self.seeds.tolist(), self.succeeded.tolist(), self.digest_column.hex()
        kept = self.kept_column or b"\1" * len(self)
        for place in range(len(self)) if places is None else places:
            if succeeded[place]:
                sha256 = digests[2 * DIGEST * place : 2 * DIGEST * (place + 1)]
                yield RolloutFact(
                    rollout_at(self.rollout, place, self.replicates),
                    seeds[place],
                    sha256,
                    self.size,
                    self.path,
                    None if robustness is None else robustness[place],
                    tolerance[place],
                    ended[place] if ended[place] == ended[place] else None,
                    batch=self.sha256,
                    kept=bool(kept[place]),
                )

    def alone(self, rollout: RolloutId) -> RolloutFact | None:
        """Return the fact of one of its rollouts; None where that has failed."""
        return next(self.each([self.place(rollout)]), None)


@dataclass(frozen=True, slots=True)
class BlockObservationFact:
    """The observation of each test of a block; `chain` is the head of the problem's hash chain after all of them."""

    problem: str
    test: int
    y_column: bytes
    each_column: bytes
    chain: str = ""

    @classmethod
    def of(cls, problem: str, test: int, y: Floats, each: Floats) -> "BlockObservationFact":
        """Return the fact of `y` (k,) and the contributions `each` (k, w), without its link of the chain."""
        # + 0.0: a zero has no sign, as in `Observation`.
        return cls(problem, test, column(y + 0.0), column(each))

    def __len__(self) -> int:
        return len(self.y_column) // 8

    @property
    def y(self) -> Floats:
        """The observation of each test, shape (k,)."""
        return np.frombuffer(self.y_column)

    @property
    def contributions(self) -> Floats:
        """What each replicate contributed, shape (k, w)."""
        return np.frombuffer(self.each_column).reshape(len(self), -1)

    def each(self) -> Iterator[ObservationFact]:
        """Yield the observation of each test; the link of the chain is that of the block."""
        pairs = zip(self.y.tolist(), self.contributions.tolist(), strict=True)
        for test, (y, each) in enumerate(pairs, start=self.test):
            yield ObservationFact(self.problem, test, Observation(y, tuple(each)), self.chain)


BlockFact = BlockProposalFact | BatchFact | BlockObservationFact
StoredFact = Fact | BlockFact
"""As the journal has them."""


def places(fact: RolloutFact | BatchFact) -> int:
    """Return the rollouts of a file of its facts, failed ones included; 0 for that of one rollout without a batch."""
    return len(fact) if isinstance(fact, BatchFact) else 0


def each_rollout(fact: RolloutFact | BatchFact) -> Iterator[RolloutFact]:
    """Yield the fact of each rollout of a batch that has a trajectory, or of one alone."""
    return fact.each() if isinstance(fact, BatchFact) else iter((fact,))


def each_violation(fact: RolloutFact | BatchFact) -> Iterator[RolloutFact]:
    """Yield the fact of each rollout that violates the specification; the others of a batch take no time."""
    if isinstance(fact, RolloutFact):
        return iter((fact,) if fact.violates else ())
    return iter(()) if fact.robustness is None else fact.each(np.flatnonzero(fact.robustness < 0.0).tolist())


def each_fact(facts: Iterable[StoredFact]) -> Iterator[Fact]:
    """Yield the facts of every test and rollout on its own, for readers that handle them one by one."""
    for fact in facts:
        if isinstance(fact, BlockFact):
            yield from fact.each()
        else:
            yield fact


def block_files_link(files: str, batches: list[BatchFact]) -> str:
    """Return the head of the chain over the rollouts alone after a block."""
    return hashlib.sha256((files + canonical_json(_rollouts(batches))).encode()).hexdigest()


def next_block_link(
    link: str,
    proposal: BlockProposalFact,
    batches: list[BatchFact],
    observation: BlockObservationFact,
    discards: list[DiscardFact],
) -> str:
    """Return the head of a problem's hash chain after one more observed block."""
    value: dict[str, object] = {
        "block": [proposal.test, len(proposal)],
        "starts": hashlib.sha256(proposal.node_column + proposal.x_column).hexdigest(),
        "rollouts": _rollouts(batches),
        "observed": hashlib.sha256(observation.y_column + observation.each_column).hexdigest(),
    }
    if discards:
        value["discards"] = sorted([str(each.rollout), each.seed, each.sha256, each.reason] for each in discards)
    return hashlib.sha256((link + canonical_json(value)).encode()).hexdigest()


def _rollouts(batches: list[BatchFact]) -> list[list[object]]:
    """Return what the chain has of the rollouts of a block: of each variant, seeds and digests in their order.

    Neither a file nor which of them failed at first is part of it: a retry gives the same rollout.
    """
    found: list[list[object]] = []
    for variant in sorted({batch.rollout.variant for batch in batches}):
        of_variant = [batch for batch in batches if batch.rollout.variant == variant]
        keys = np.concatenate([_keys(batch) for batch in of_variant])
        columns = np.concatenate(
            [np.hstack((batch.seeds.view(np.uint8).reshape(-1, 8), batch.digests)) for batch in of_variant]
        )
        kept = np.concatenate([batch.succeeded for batch in of_variant])
        order = np.lexsort((keys[kept, 1], keys[kept, 0]))
        found.append([variant, len(order), hashlib.sha256(columns[kept][order].tobytes()).hexdigest()])
    return found


def _keys(batch: BatchFact) -> Integers:
    """Return test and replicate of each rollout, shape (R, 2)."""
    tests = np.repeat(np.arange(batch.tests.start, batch.tests.stop), batch.replicates)
    numbers = batch.rollout.replicate + np.tile(np.arange(batch.replicates), len(batch.tests))
    return np.column_stack((tests, numbers))
