"""Where the tests of a problem come from: its method, or a search for a counterexample."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ...schemas.file.parameters import knots_alike
from ...schemas.result.block_facts import BlockObservationFact, Floats, Integers
from ...schemas.result.facts import Header, ObservationFact
from ...schemas.values import Bound, Proposal
from ..mathematics.bounds.sample import SampleMethod
from ..mathematics.gp.points import point_at
from ..mathematics.search import Falsifier
from ..mathematics.search.clusters import Clusters
from ..mathematics.stl.condition import Truth
from .methods import ProblemMethod
from .observation import for_search, goal_of_search
from .plan import ProblemPlan
from .region import Condition, Start, condition
from .seeds import first_node, uniform
from .series import FailureClusters, Series, worst_rollout
from .starts import AllowedStarts, Draws, Listed, drawn_starts, of_space


class ProposalSource(Protocol):
    """The source of the tests of one problem; called in the order of its facts."""

    def propose(self, series: Series, test: int) -> Proposal:
        """Return the next test; it changes nothing."""
        ...

    def rival(self, series: Series, test: int, x: Sequence[float]) -> Proposal | None:
        """Return the proposal of `x` (p,) if another CPU, which rounds differently, could have chosen it."""
        ...

    def propose_block(self, series: Series, tests: range) -> tuple[Integers, Floats]:
        """Return nodes (k,) and starts (k, p) of the next tests, which no observation decides; it changes nothing."""
        ...

    def rival_in_block(self, series: Series, place: int, x: Sequence[float]) -> Proposal | None:
        """Return the proposal of `x` (p,) in a place of the next block, as `rival` does."""
        ...

    def observe(self, series: Series, fact: ObservationFact | BlockObservationFact) -> Bound:
        """Take the observation of the test that the series closed last, once, and return the bound after it."""
        ...


def proposal_source(
    plan: ProblemPlan, method: ProblemMethod, header: Header, clusters: FailureClusters | None = None
) -> ProposalSource:
    """Return the source that the campaign file asks for, with the clusters of the account; see `failure_clusters`."""
    if plan.falsify is None:
        return MethodSource(plan, method, header)
    return SearchSource(plan, method, header, clusters)


def failure_clusters(plan: ProblemPlan, header: Header) -> FailureClusters | None:
    """Return the clusters that the failing tests of a search are sorted into; None of one that ends with the first."""
    if plan.falsify is None or plan.falsify.until == "counterexample":
        return None
    space, region = searched_space(plan, header)

    def middle(one: Start, other: Start) -> Start | None:
        found = space.nearest((np.array(one) + np.array(other)) / 2, ())[1]
        return found if region is None or region([found])[0] else None

    low, high = space.box
    return Clusters(tuple(low.tolist()), tuple(high.tolist()), middle)


def searched_space(plan: ProblemPlan, header: Header) -> tuple[AllowedStarts, Condition | None]:
    """Return the starts that a search may choose, with the region that they have to be in; see `condition`."""
    if plan.candidates is None:
        return of_space(header), condition(header.config.where, plan.parameters)
    # Of candidates every one is in the region.
    return Listed(plan.candidates.nodes), None


def first_start(plan: ProblemPlan, header: Header) -> Start:
    """Return the start of the first test of a problem, from the seed alone.

    Where a design, the order of a list or a search decides the first test, it is another start of the same space: a
    plan of weights may take hours.
    """
    if plan.candidates is None:
        return drawn_starts(header, plan.name)(0)
    return point_at(plan.candidates, first_node(header, plan.name, plan.candidates.size))


class MethodSource:
    """The method of the problem."""

    def __init__(self, plan: ProblemPlan, method: ProblemMethod, header: Header) -> None:
        self._name, self._method, self._header = plan.name, method, header

    def propose(self, series: Series, test: int) -> Proposal:
        """Return the next test; the first one follows from the seed."""
        first = first_node(self._header, self._name, self._method.size) if test == 0 else None
        return self._method.propose(first, _nodes(series))

    def rival(self, series: Series, test: int, x: Sequence[float]) -> Proposal | None:
        """Return the proposal of `x` (p,); the first test is drawn by the seed alone and has none."""
        return self._method.rival(x, _nodes(series)) if test else None

    def propose_block(self, series: Series, tests: range) -> tuple[Integers, Floats]:
        """Return the next tests."""
        return self._method.propose_each(len(tests), len(_nodes(series)))

    def rival_in_block(self, series: Series, place: int, x: Sequence[float]) -> Proposal | None:
        """Return the proposal of `x` (p,): in a block no test depends on which others are in flight."""
        return self._method.rival(x, [*_nodes(series), *[0] * place])

    def observe(self, series: Series, fact: ObservationFact | BlockObservationFact) -> Bound:
        """Give the observation to the method."""
        assert series.last_proposal is not None
        if isinstance(fact, BlockObservationFact):
            nodes = np.array(series.nodes[-len(fact) :], dtype=np.int64)
            return self._method.observe_each(nodes, fact.y, fact.contributions)
        return self._method.observe(series.last_proposal, fact.observation)


class SearchSource:
    """A search, whose tests the method only observes; where starts are drawn, it proposes and observes the drawn ones.

    The bounds of methods `rigorous` and `scenario` hold for every rule that chooses a test from the observations
    before it, and so for this one.
    """

    def __init__(
        self, plan: ProblemPlan, method: ProblemMethod, header: Header, clusters: FailureClusters | None
    ) -> None:
        assert plan.falsify is not None, "the file asks for it"
        self._plan, self._method, self._clusters = plan, method, clusters
        self._space, self._region = searched_space(plan, header)
        self._drawn_instead = Draws(header, f"{plan.name}.search") if self._region else None
        low, high = self._space.box
        seed = int(uniform(header, f"{plan.name}.search", range(1), 1)[0, 0] * 2**53)
        # Ends of a range that are equal: a parameter that never changes, in a box that has to have an inside.
        high = np.where(high > low, high, low + 1.0)
        self._goal, self._has_scale = goal_of_search(header.config, header.spec)[0], plan.falsify.scale is not None
        self._search = Falsifier(
            low.tolist(),
            high.tolist(),
            seed=seed,
            random_every=plan.falsify.random_every,
            admitted=self._region if clusters is None else self._elsewhere,
            signals=knots_alike(header.config.space, plan.parameters),
            goal=self._goal,
        )

    def propose(self, series: Series, test: int) -> Proposal:
        """Return the start that is nearest to the search's, or the next drawn one."""
        if self._plan.is_drawn(test):
            return self._method.propose(None, self._drawn(series))
        if (middle := self._between_failures(series, test)) is not None:
            return self._searched(test, *self._space.nearest(np.array(middle), ()))
        # Without noise a repeat shows nothing, and method `rigorous` takes none.
        taken = [*series.nodes, *_nodes(series)] if self._plan.exact else ()
        node, x = self._space.nearest(np.array(self._search.propose(_open_starts(series))), taken)
        # The middle of the box, a rounded start, or a region so small that no candidate of the search is in it.
        if self._region is not None and self._drawn_instead is not None and not self._region([x])[0]:
            x = self._drawn_instead.start(test)
        return self._searched(test, node, x)

    def rival(self, series: Series, test: int, x: Sequence[float]) -> Proposal | None:
        """Return the proposal of `x` (p,) if it is a start of the space and as good as the search's own."""
        if self._plan.is_drawn(test):
            return self._method.rival(x, self._drawn(series))
        if self._between_failures(series, test) is not None:
            return None
        own = self.propose(series, test)
        node, nearest = self._space.nearest(np.array(x), ())
        if nearest != tuple(x) or (self._region is not None and not self._region([nearest])[0]):
            return None
        # Rounding grows in the fit of the length scales, so another CPU may choose a start that is far from this one.
        if not self._search.is_as_good(nearest, own.x, _open_starts(series)):
            return None
        return Proposal(own.node if node is None else node, nearest, None, None, None, None)

    def propose_block(self, series: Series, tests: range) -> tuple[Integers, Floats]:
        """Raise: a search chooses each test from those before it."""
        raise NotImplementedError

    def rival_in_block(self, series: Series, place: int, x: Sequence[float]) -> Proposal | None:
        """Raise, as `propose_block` does."""
        raise NotImplementedError

    def observe(self, series: Series, fact: ObservationFact | BlockObservationFact) -> Bound:
        """Give the worst robustness of the test to the search, and the observation to the method if it is evidence."""
        proposal = series.last_proposal
        assert proposal is not None
        assert isinstance(fact, ObservationFact)
        # The worst, not the mean: one rollout below 0 is the counterexample.
        worst = worst_rollout(series.last_rollouts)
        assert worst.robustness is not None
        # A drawn start may have a disturbance beyond what a search chooses.
        x = tuple(np.clip(proposal.x, *self._space.box).tolist())
        self._search.observe(x, *for_search(self._goal, worst.robustness, worst.parts, has_scale=self._has_scale))
        if self._plan.is_evidence(fact.test):
            return self._method.observe(proposal, fact.observation)
        # A start that was chosen by the outcomes before it is no sample: the bound is that of the samples so far.
        assert isinstance(self._method, SampleMethod)
        return self._method.bound()

    @staticmethod
    def _searched(test: int, node: int | None, x: Start) -> Proposal:
        # A start that is drawn from no list has no number: -1 - test, which no drawn one has.
        return Proposal(-1 - test if node is None else node, x, None, None, None, None)

    def _between_failures(self, series: Series, test: int) -> Start | None:
        """Return the start that decides whether a failing test is of a cluster; None where nothing is open.

        Tests at random stay what they are: a wrong rule cannot blind the search.
        """
        if self._clusters is None or self._search.is_random(test):
            return None
        in_flight = _open_starts(series)
        return next((each for each in self._clusters.middles if each not in in_flight), None)

    def _elsewhere(self, starts: Floats) -> Truth:
        """Whether the models may choose each of some starts: in the region, and away from the known failures."""
        inside = np.full(len(starts), fill_value=True) if self._region is None else self._region(starts)
        return inside if self._clusters is None else inside & ~self._clusters.near(starts)

    def _drawn(self, series: Series) -> list[int]:
        return [fact.proposal.node for test, fact in series.proposals.items() if self._plan.is_drawn(test)]


def _nodes(series: Series) -> list[int]:
    # Tests in flight: a method counts them as observed, so that a window > 1 does not repeat one start.
    blocks = [node for block in series.blocks.values() for node in block.nodes.tolist()]
    return [fact.proposal.node for fact in series.proposals.values()] + blocks


def _open_starts(series: Series) -> list[Start]:
    return [fact.proposal.x for fact in series.proposals.values()]
