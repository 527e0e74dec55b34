"""A series of tests: its open tests by number, and sums over its closed ones."""

import hashlib
from array import array
from collections.abc import Iterable, MutableSequence
from dataclasses import dataclass, field

from ...schemas.base import canonical_json
from ...schemas.errors import IllegalEvent
from ...schemas.ids import RolloutId
from ...schemas.result.facts import BoundFact, DiscardFact, ObservationFact, ProposalFact, RolloutFact, next_link
from ...schemas.values import MARKED, Bound, Observation, ProblemProgress, Proposal, distance_after

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
    discards: list[DiscardFact] = field(default_factory=list)
    """Of all tests: they are few."""
    observations: MutableSequence[float] = field(default_factory=lambda: array("d"))
    each: list[tuple[float, ...]] = field(default_factory=list)
    nodes: list[int] = field(default_factory=list)
    by_tolerance: Remarked = field(default_factory=Remarked)
    """Rollouts whose sign the tolerance around time stamps could decide."""
    ended: Remarked = field(default_factory=Remarked)
    """Rollouts that ended before the horizon."""
    counts: dict[str, int] = field(default_factory=lambda: {"nominal": 0, "true": 0})
    last_proposal: Proposal | None = None
    last_rollouts: list[RolloutFact] = field(default_factory=list)
    """Of the test that was observed last."""
    due: BoundFact | None = None
    """The bound that follows from the last observation, until its fact is there."""
    last_bound: BoundFact | None = None
    course: list[tuple[int, float, float | None]] = field(default_factory=list)
    """As in `ProblemProgress`."""
    budgets: list[int] = field(default_factory=list)
    """Tests at most after each extension of the campaign that this series has part in."""

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
        rollouts = self.last_rollouts = self.rollouts.pop(fact.test, [])
        self.link = fact.chain
        self.files = _files_link(self.files, rollouts)
        self.observations.append(found.y)
        self.each.append(found.each)
        self.nodes.append(self.last_proposal.node)
        for rollout in rollouts:
            self.counts[rollout.rollout.variant] += 1
        self.by_tolerance.add(each.rollout for each in rollouts if each.by_tolerance)
        self.ended.add(each.rollout for each in rollouts if each.ended is not None)
        return rollouts

    def bound(self, fact: BoundFact) -> None:
        """Take the bound after an observation; it is the one that is due."""
        due, self.due = self.due, None
        # Not in the hash chain, because it follows: so an edited bound shows only by computing it again.
        if due is None or due.stopped_by != fact.stopped_by or not _same_bound(due.bound, fact.bound):
            raise IllegalEvent(
                f"the bound after test {fact.test} of {fact.problem} is not the one that follows from the observations"
            )
        self.last_bound = fact
        if fact.bound.upper is not None and fact.test + 1 in MARKED:
            last_f = self.last_proposal.F if self.last_proposal else None
            self.course.append((fact.test + 1, fact.bound.upper, distance_after(fact.bound, last_f)))


def _files_link(link: str, rollouts: list[RolloutFact]) -> str:
    # Sorted: the order in which rollouts arrive depends on the workers.
    listed = sorted([str(each.rollout), each.seed, each.sha256] for each in rollouts)
    return hashlib.sha256((link + canonical_json(listed)).encode()).hexdigest()


def _same_bound(recomputed: Bound, recorded: Bound) -> bool:
    pairs = ((recomputed.upper, recorded.upper), (recomputed.lower, recorded.lower))
    # Equal first: two infinities are the same bound, but their difference is no number.
    return all(a is b if a is None or b is None else a == b or abs(a - b) <= ROUND_OFF for a, b in pairs)
