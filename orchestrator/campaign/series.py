"""The tests of a problem: open ones by number, sums over closed ones, and what the audit needs of rollouts."""

import hashlib
import itertools
import math
from array import array
from collections import Counter
from collections.abc import Iterable, MutableSequence, Sequence
from dataclasses import dataclass, field, replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ...schemas.base import canonical_json
from ...schemas.errors import IllegalEvent
from ...schemas.file.keys import most_kept
from ...schemas.file.problem_models import KernelProblem
from ...schemas.ids import RolloutId
from ...schemas.result.block_facts import (
    BatchFact,
    BlockObservationFact,
    BlockProposalFact,
    block_files_link,
    each_rollout,
    next_block_link,
)
from ...schemas.result.facts import (
    BoundFact,
    DiscardFact,
    ExtensionFact,
    ObservationFact,
    ProposalFact,
    RolloutFact,
    extended_link,
    next_link,
)
from ...schemas.values import MARKED, Bound, Observation, ProblemProgress, Proposal, distance_after
from ..mathematics.search.clusters import Clusters, violated_parts
from . import objectives
from .plan import ProblemPlan

FailureClusters = Clusters[RolloutFact]
"""Clusters of failing tests, each by its worst rollout."""
ROUND_OFF = 1e-9
"""A bound recomputed on another CPU may differ by less."""


@dataclass(slots=True)
class Remarked:
    """Rollouts of closed tests of which something is to be said: their number, and the first of them."""

    number: int = 0
    first: RolloutId | None = None

    def add(self, rollouts: Iterable[RolloutId]) -> None:
        """Take those of a test that is closed, in whatever order they came."""
        found = sorted(rollouts)
        self.number += len(found)
        self.first = self.first or next(iter(found), None)


class Rows(Sequence[tuple[float, ...]]):
    """Rows of numbers, which take 8 bytes each and 8 a row."""

    def __init__(self, rows: Iterable[Sequence[float]] = ()) -> None:
        self._values, self._ends = array("d"), array("q", [0])
        for row in rows:
            self.append(row)

    def append(self, row: Sequence[float]) -> None:
        """Add one row."""
        self._values.extend(row)
        self._ends.append(len(self._values))

    def extend(self, rows: NDArray[np.float64]) -> None:
        """Add the rows of an array (k, w)."""
        first, width = len(self._values), rows.shape[1]
        self._values.frombytes(np.ascontiguousarray(rows).tobytes())
        self._ends.extend(range(first + width, first + rows.size + 1, width) if width else [first] * len(rows))

    def firsts(self, start: int) -> NDArray[np.float64]:
        """Return the first number of each row from `start` on (k,); of an empty row it is NaN."""
        ends, values = np.frombuffer(self._ends, np.int64), np.frombuffer(self._values)
        found = np.full(len(self) - start, np.nan)
        begins, filled = ends[start:-1], ends[start:-1] < ends[start + 1 :]
        found[filled] = values[begins[filled]]
        return found

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __eq__(self, other: object) -> bool:
        """Whether both have the same rows: a replay is compared with the campaign that it repeats."""
        return isinstance(other, Rows) and (self._ends, self._values) == (other._ends, other._values)

    __hash__ = None  # type: ignore[assignment]  # rows are added

    @overload
    def __getitem__(self, place: int) -> tuple[float, ...]: ...

    @overload
    def __getitem__(self, place: slice) -> list[tuple[float, ...]]: ...

    def __getitem__(self, place: int | slice) -> tuple[float, ...] | list[tuple[float, ...]]:
        if isinstance(place, slice):
            return [self[each] for each in range(*place.indices(len(self)))]
        place = range(len(self))[place]
        return tuple(self._values[self._ends[place] : self._ends[place + 1]])


@dataclass(slots=True)
class Series:
    """The facts of the tests of one problem, or of one check: whole while a test is open, and summed up afterwards.

    So the memory grows by some numbers per test, not by its facts. A fact that does not follow from those before it
    raises `IllegalEvent`.
    """

    link: str
    """The head of the hash chain."""
    files: str = ""
    """The head of a second chain, over the rollouts alone: unlike `link` it is the same on every CPU."""
    proposals: dict[int, ProposalFact] = field(default_factory=dict)
    rollouts: dict[int, list[RolloutFact]] = field(default_factory=dict)
    blocks: dict[int, BlockProposalFact] = field(default_factory=dict)
    """Open ones, by their first tests; a series has tests or blocks."""
    batches: dict[int, list[BatchFact]] = field(default_factory=dict)
    discards: list[DiscardFact] = field(default_factory=list)
    """Of all tests: they are few."""
    failed: int = 0
    """Rollouts of closed tests that have failed in their batch, so that another attempt at each was recorded."""
    observations: MutableSequence[float] = field(default_factory=lambda: array("d"))
    each: Rows = field(default_factory=Rows)
    nodes: MutableSequence[int] = field(default_factory=lambda: array("q"))
    by_tolerance: Remarked = field(default_factory=Remarked)
    """Rollouts whose sign the tolerance around time stamps could decide."""
    ended: Remarked = field(default_factory=Remarked)
    """Rollouts that ended before the horizon."""
    counts: dict[str, int] = field(default_factory=lambda: {"nominal": 0, "true": 0})
    last_proposal: Proposal | None = None
    last_facts: Sequence[RolloutFact | BatchFact] = ()
    """Of the test, or the block, that was observed last."""
    due: BoundFact | None = None
    """The bound that follows from the last observation, until its fact is there."""
    last_bound: BoundFact | None = None
    course: list[tuple[int, float, float | None]] = field(default_factory=list)
    """As in `ProblemProgress`."""
    budgets: list[int] = field(default_factory=list)
    """Tests at most after each extension of the campaign that this series has part in."""
    kept: "Kept" = field(default_factory=lambda: Kept("all"))
    _failed: Counter[int] = field(default_factory=Counter)
    """Of open tests, or blocks, as in `failed`."""

    @property
    def last_rollouts(self) -> list[RolloutFact]:
        """The rollouts of the test, or the block, that was observed last."""
        return [rollout for fact in self.last_facts for rollout in each_rollout(fact)]

    @property
    def progress(self) -> ProblemProgress:
        """The progress of the series."""
        last, proposal = self.last_bound, self.last_proposal
        return ProblemProgress(
            len(self.observations),
            sum(self.counts.values()),
            proposal.F if proposal and last else None,
            last.bound if last else None,
            last.stopped_by if last else None,
            self.budgets[-1] if self.budgets else None,
            tuple(self.course),
        )

    def propose(self, fact: ProposalFact | BlockProposalFact) -> None:
        """Take the proposal of a test, or of a block."""
        if isinstance(fact, BlockProposalFact):
            self.blocks[fact.test] = fact
        else:
            self.proposals[fact.test] = fact

    def record(self, fact: BatchFact) -> None:
        """Take a recorded batch of an open test, or block."""
        self._failed[fact.block] += len(fact.failures)
        if fact.block in self.blocks:
            self.batches.setdefault(fact.block, []).append(fact)
        else:
            self.rollouts.setdefault(fact.block, []).extend(fact.each())

    def has_begun(self, first: RolloutId, replicates: int) -> bool:
        """Whether the batch of an open test, or block, that begins with `first` is recorded, also if `first` failed."""
        # Of a batch at least one rollout has a trajectory; retries come after it.
        facts = self.batches.get(first.test) or self.rollouts.get(first.test, [])
        numbers = range(first.replicate, first.replicate + replicates)
        return any(each.rollout.variant == first.variant and each.rollout.replicate in numbers for each in facts)

    def starts(self, first: int, tests: int) -> list[Sequence[float]]:
        """Return the starts of so many open tests of one block, from `first` on."""
        if first in self.proposals:
            return [self.proposals[first].proposal.x]
        block = next(each for each in self.blocks.values() if each.test <= first < each.test + len(each))
        found: list[Sequence[float]] = block.x[first - block.test : first - block.test + tests].tolist()
        return found

    def next_link(self, test: int, observation: Observation) -> str:
        """Return the head of the hash chain after the observation of an open test."""
        discards = [fact for fact in self.discards if fact.rollout.test == test]
        return next_link(self.link, self.proposals[test], self.rollouts.get(test, ()), observation, discards)

    def observe(self, fact: ObservationFact) -> list[RolloutFact]:
        """Close an observed test: move it from the open ones into the sums; return its rollouts."""
        found = fact.observation
        # The link covers the proposal, the digests and y: an edit of one of them in the database shows here.
        if self.next_link(fact.test, found) != fact.chain:
            raise IllegalEvent(f"test {fact.test} of {fact.problem} was changed after it was written (hash chain)")
        self.last_proposal = self.proposals.pop(fact.test).proposal
        rollouts = self.last_facts = self.rollouts.pop(fact.test, [])
        self.link = fact.chain
        self.failed += self._failed.pop(fact.test, 0)
        self.files = _files_link(self.files, rollouts)
        self.observations.append(found.y)
        self.each.append(found.each)
        self.nodes.append(self.last_proposal.node)
        for rollout in rollouts:
            self.counts[rollout.rollout.variant] += 1
        self.by_tolerance.add(each.rollout for each in rollouts if each.by_tolerance)
        self.ended.add(each.rollout for each in rollouts if each.ended is not None)
        return rollouts

    def observe_block(self, fact: BlockObservationFact) -> list[BatchFact]:
        """Close an observed block, as `observe` closes a test; return its batches."""
        proposal, batches = self.blocks.pop(fact.test), self.batches.pop(fact.test, [])
        if self.next_block_link(proposal, batches, fact) != fact.chain:
            raise IllegalEvent(
                f"tests {fact.test} to {fact.test + len(fact) - 1} of {fact.problem} were changed after they were "
                "written (hash chain)"
            )
        self.last_proposal, self.last_facts = proposal.of_test(fact.test + len(fact) - 1).proposal, batches
        self.link, self.files = fact.chain, block_files_link(self.files, batches)
        self.failed += self._failed.pop(fact.test, 0)
        self.observations.extend(fact.y.tolist())
        self.each.extend(fact.contributions)
        self.nodes.extend(proposal.nodes.tolist())
        for batch in batches:
            kept = batch.succeeded
            self.counts[batch.rollout.variant] += int(kept.sum())
            for marks, remarked in ((batch.by_tolerance, self.by_tolerance), (~np.isnan(batch.ended), self.ended)):
                if (marked := marks & kept).any():
                    remarked.add(itertools.compress(batch.rollouts, marked))
        return batches

    def next_block_link(
        self, proposal: BlockProposalFact, batches: list[BatchFact], observation: BlockObservationFact
    ) -> str:
        """Return the head of the hash chain after the observation of an open block."""
        tests = range(proposal.test, proposal.test + len(proposal))
        discards = [fact for fact in self.discards if fact.rollout.test in tests]
        return next_block_link(self.link, proposal, batches, observation, discards)

    def bound(self, fact: BoundFact) -> None:
        """Take the bound after an observation; it is the one that is due."""
        due, self.due = self.due, None
        # Not in the hash chain, because it follows: so an edited bound shows only by computing it again.
        if due is None or due.stopped_by != fact.stopped_by or not _same_bound(due.bound, fact.bound):
            raise IllegalEvent(
                f"the bound after test {fact.test} of {fact.problem} is not the one that follows from the observations"
            )
        before, tests = 0 if self.last_bound is None else self.last_bound.test + 1, fact.test + 1
        self.last_bound = fact
        if fact.bound.upper is not None and not MARKED.isdisjoint(range(before + 1, tests + 1)):
            last_f = self.last_proposal.F if self.last_proposal else None
            self.course.append((tests, fact.bound.upper, distance_after(fact.bound, last_f)))


def _files_link(link: str, rollouts: list[RolloutFact]) -> str:
    # Sorted: the order in which rollouts arrive depends on the workers.
    listed = sorted([str(each.rollout), each.seed, each.sha256] for each in rollouts)
    return hashlib.sha256((link + canonical_json(listed)).encode()).hexdigest()


def _same_bound(recomputed: Bound, recorded: Bound) -> bool:
    pairs = ((recomputed.upper, recorded.upper), (recomputed.lower, recorded.lower))
    # Equal first: two infinities are the same bound, but their difference is no number.
    return all(a is b if a is None or b is None else a == b or abs(a - b) <= ROUND_OFF for a, b in pairs)


def worst_rollout(rollouts: Iterable[RolloutFact]) -> RolloutFact:
    """Return the rollout of least robustness; raises ValueError without any.

    Of equal ones that of the least parts, then the first by its name: the order of arrival depends on the workers.
    """
    scored = (each for each in rollouts if each.robustness is not None)
    return min(scored, key=lambda each: (each.robustness, each.parts, each.rollout))


# The account of a problem


class Kept:
    """Which rollouts of a problem keep their samples, by the key `keep`.

    `failures` are those at robustness 0 or below, with which a rollout counts as a violation. Of `worst N` a rollout is
    kept if fewer than N of the tests that were closed when its own was proposed are as bad. Neither workers nor the
    order of arrival decides that; the N worst of all are among them, beside those that were so at their time.
    """

    def __init__(self, keep: str) -> None:
        self._most = most_kept(keep)
        self._all = keep == "all"
        self.number = 0
        """Rollouts of closed tests that keep their samples."""
        self._worst = np.empty(0)
        self._limits: dict[int, float] = {}

    def __eq__(self, other: object) -> bool:
        """Whether both will decide alike."""
        return isinstance(other, Kept) and self._state == other._state

    __hash__ = None  # type: ignore[assignment]  # it changes

    @property
    def _state(self) -> tuple[object, ...]:
        return self._all, self._most, self.number, self._worst.tolist(), self._limits

    def propose(self, test: int) -> None:
        """Take a proposed test, or the first one of a block."""
        if self._most is not None:
            self._limits[test] = self._worst[-1] if len(self._worst) == self._most else math.inf

    def observe(self, test: int, robustness: NDArray[np.float64], number: int) -> None:
        """Take the robustness (n,) of all rollouts of a test, or a block, that is closed, `number` of them kept."""
        self.number += number
        if self._most is not None:
            del self._limits[test]
            self._worst = np.sort(np.concatenate((self._worst, robustness)))[: self._most]

    def places(self, test: int, robustness: NDArray[np.float64]) -> list[int] | None:
        """Return which rollouts (R,) of an open test, or block, are kept, a failed one having NaN; None for all."""
        if self._all:
            return None
        if self._most is None:
            return np.flatnonzero(robustness <= 0).tolist()
        order = np.argsort(robustness, kind="stable")[: self._most]
        return sorted(order[robustness[order] < self._limits[test]].tolist())


@dataclass(slots=True)
class Account(Series):
    """The facts of one problem."""

    plan: ProblemPlan = field(kw_only=True)
    proposed: list[Proposal] = field(default_factory=list)
    """The proposals of the closed tests, where a kernel method may be given them again; its kernel rows cost more."""
    excess: float = -math.inf
    """Of a gap: the most by which a robustness differed beyond L times the gap; above 0 it dominates nothing."""
    robustness: MutableSequence[float] = field(default_factory=lambda: array("d"))
    clusters: FailureClusters | None = None
    """Of a search that continues after its first failure."""
    lowest: tuple[tuple[float, ...], RolloutFact] | None = None
    """Of a search: the start and the rollout of least robustness, of equal ones the first."""

    @property
    def budget(self) -> int:
        """Tests at most, with the extensions."""
        return self.budgets[-1] if self.budgets else self.plan.budget

    @property
    def observed(self) -> list[Observation]:
        """The observations of the closed tests, in test order."""
        return list(map(Observation, self.observations, self.each))

    @property
    def closed(self) -> list[tuple[Proposal, Observation]]:
        """The closed tests of a problem with a kernel, in test order."""
        return list(zip(self.proposed, self.observed, strict=True))

    def propose(self, fact: ProposalFact | BlockProposalFact) -> None:
        """Take a proposal, as every series does."""
        Series.propose(self, fact)
        self.kept.propose(fact.test)

    def extend(self, fact: ExtensionFact) -> None:
        """Take an extension of the campaign."""
        # In the chain of every problem: one extension and two in steps differ, even where all rollouts are equal.
        self.link = extended_link(self.link, fact)
        budget = dict(fact.budgets).get(self.plan.name)
        if budget is not None:
            self.budgets.append(budget)
            # The bound stays as it is, but is no end any more.
            self.last_bound = replace(self.last_bound, budget=False) if self.last_bound else None

    def observe_block(self, fact: BlockObservationFact) -> list[BatchFact]:
        """Close an observed block, as every series does, and take the robustness of its rollouts."""
        proposal = self.blocks[fact.test]
        batches = Series.observe_block(self, fact)
        if isinstance(self.plan.problem, KernelProblem):
            self.proposed.extend(each.proposal for each in proposal.each())
        if self.plan.objective.measured == "gap":
            by_test: dict[int, dict[tuple[str, int], float]] = {}
            for each in self.last_rollouts:
                by_test.setdefault(each.rollout.test, {})[each.rollout[2:]] = each.robustness or 0.0
            for test, each in enumerate(fact.contributions.tolist(), start=fact.test):
                self.excess = max(self.excess, objectives.excess(self.plan, by_test[test], self.plan.values_of(each)))
        margins = [each.robustness[each.succeeded] for each in batches if each.robustness is not None]
        number = sum(int(each.succeeded.sum()) if each.kept is None else len(each.kept) for each in batches)
        self._take(fact.test, np.concatenate(margins) if margins else np.empty(0), number)
        return batches

    def observe(self, fact: ObservationFact) -> list[RolloutFact]:
        """Close an observed test, as every series does, and take the robustness of its rollouts."""
        rollouts = Series.observe(self, fact)  # by name: `super()` finds no cell in a class with slots
        if isinstance(self.plan.problem, KernelProblem) and self.last_proposal is not None:
            self.proposed.append(self.last_proposal)
        if self.plan.objective.measured == "gap":
            # The composition needs a gap that dominates the robustness difference in every pair: checked by the audit.
            robustness = {(each.rollout.variant, each.rollout.replicate): each.robustness or 0.0 for each in rollouts}
            gaps = self.plan.values_of(fact.observation.each)
            self.excess = max(self.excess, objectives.excess(self.plan, robustness, gaps))
        if self.plan.falsify is not None and self.last_proposal is not None:
            self._seek(self.last_proposal.x, worst_rollout(rollouts))
        margins = [each.robustness for each in rollouts if each.robustness is not None]
        self._take(fact.test, np.array(margins), sum(each.kept for each in rollouts))
        return rollouts

    def _seek(self, start: tuple[float, ...], worst: RolloutFact) -> None:
        """Take the worst rollout of a test of a search."""
        margin = worst.robustness or 0.0
        if self.lowest is None or margin < (self.lowest[1].robustness or 0.0):
            self.lowest = start, worst
        if self.clusters is not None:
            self.clusters.observe(start, margin, violated_parts(margin, worst.parts), worst)

    def _take(self, test: int, robustness: NDArray[np.float64], number: int) -> None:
        self.robustness.extend(robustness.tolist())
        self.kept.observe(test, robustness, number)
