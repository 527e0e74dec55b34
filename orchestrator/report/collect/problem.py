"""The part of the collector for one problem, or for one of its requirements: its tests, and its method fed with them.

Facts are in terms of the maximised objective J; the data carry the sign of the problem's own objective, so upper and
lower change places for a minimum.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ....schemas.file.config import CampaignConfig
from ....schemas.file.parts import alpha_of
from ....schemas.result.block_facts import BlockObservationFact, BlockProposalFact
from ....schemas.result.certificate import Predicate, ProblemResult
from ....schemas.result.facts import BoundFact, ExtensionFact, Header, ObservationFact, ProposalFact
from ....schemas.values import MARKED, Bound, Guess, Observation, ProblemProgress, StoppedBy, distance_after
from ...campaign import consistency
from ...campaign.clip import by_clip, floored
from ...campaign.methods import PartMethod, ProblemMethod, method
from ...campaign.plan import ProblemPlan
from ...certificate.problem_results import objective
from ...forecast.outlook import in_words, left_in_words, remaining_tests
from ...forecast.planned_outlook import PlannedOutlooks
from ...mathematics.bounds.sample import SampleMethod
from ...store.changes import Decision
from ...store.export_tables import robustness_unit, unit
from ...store.facts import ObservedTest
from ..data.charts import ProblemCharts
from ..data.page import Drawn, Problem, RegionMap, Surface
from ..data.ranges import long_inputs
from . import band, importance, limits
from .drawn import histograms
from .observed import observed_series, signed, worst_first
from .recorded_tests import Observed, ObservedTests, ProposedTests
from .regions import region_map
from .wording import typeset


def empty_charts(config: CampaignConfig, plan: ProblemPlan) -> ProblemCharts:
    """Return the charts of a problem before its first test; `config` is that of the campaign."""
    return ProblemCharts(
        required=limits.required(config, plan), of_robustness=limits.is_robustness(plan), clip=limits.ends(plan)
    )


def charts_after(
    charts: ProblemCharts,
    plan: ProblemPlan,
    method: ProblemMethod,
    bound: Bound,
    observed: ObservedTests,
    *,
    read: Sequence[int],
) -> ProblemCharts:
    """Return the charts of a problem after its last observed test, whose bound is `bound`.

    `read` are the parameters that are no knots of a long input over time.
    """
    if isinstance(method, SampleMethod):
        drawn = drawn_tests(plan, observed)
        found = importance.of_drawn_tests(observed.x[drawn], observed.each[drawn, 0], read)
        return replace(charts, importance=found)
    uncut = np.array(method.band(bound).mean)
    mean = limits.within(uncut, plan)
    beyond = ~np.isnan(uncut) & (uncut != mean)
    of_model = importance.of_model(plan, mean if plan.sense == "max" else 0.0 - mean)
    return replace(charts, importance=of_model, overshoots=float(beyond.mean()))


Own = Callable[[Observation], Observation]
"""The observation of one requirement in that of a test."""

SOME = 1000
"""Tests among which the worst starts are sought at once."""


class ProblemCollector:
    """The facts of one problem so far; surface and columns are computed again only after a new bound.

    A requirement that is bounded on its own has the tests of the problem, of which `own` returns its observation; its
    bound is not recorded, and follows from them. `config` is the campaign of what is bounded.
    """

    def __init__(self, header: Header, plan: ProblemPlan, config: CampaignConfig, own: Own | None = None) -> None:
        self.problem = plan.problem
        self.rollouts = 0
        self.proposed = ProposedTests()
        self.observed = ObservedTests(self.proposed)
        self.plan, self._method, self._header = plan, method(plan, header), header
        self._config, self._own, long = config, own, long_inputs(header)
        self._read = [k for k, each in enumerate(header.spec.parameters) if each.name not in long]
        self._bound: Bound | None = None
        self._sense = plan.sense
        self._values: list[Observed] = []
        """Observations without a bound."""
        self._pending: list[Observed] = []
        """Observations not yet passed to the method."""
        self._surfaces: tuple[Surface, ...] = ()
        self.charts = empty_charts(header.config, plan)
        self.fed: tuple[ProblemMethod, Bound] | None = None
        """The method with all observations that `data` has described, and the bound after the last; None before."""
        self._drawn: list[Drawn] = []
        self._tests = observed_series(self.plan, self.observed)
        self._extended: int | None = None
        self._planned = partial(PlannedOutlooks().of, plan, self._method)
        self._described = 0
        """Tests in surfaces and columns."""
        self._warnings = self._contradictions()

    def add(self, fact: Decision) -> None:
        """Add the next fact of this problem.

        Raises:
            ValueError: an earlier fact is missing.

        """
        match fact:
            case ProposalFact() | BlockProposalFact():
                self.proposed.add(fact)
            case ObservationFact() | BlockObservationFact():
                own = fact if self._own is None else _of_requirement(fact, self._own)
                # A search, whose tests are not all evidence, has no block.
                if self.plan.is_evidence(fact.test):
                    self._pending.append(own)
                self._values.append(own)
            case BoundFact():
                fact = fact if self._own is None else replace(fact, bound=Bound(None, None, fact.bound.verdict))
                self.observed.add(self._values, fact)
                self._values.clear()

    def extend(self, fact: ExtensionFact) -> None:
        """Take an extension of the campaign: with a larger budget the last bound is no end any more."""
        budget = dict(fact.budgets).get(self.problem.name)
        self._extended = budget or self._extended
        if budget and len(self.observed):
            self.observed.extend()

    def data(self, result: ProblemResult | None) -> Problem:
        """Return the data of the problem; `result` is its part of the certificate.

        Raises:
            ValueError: the method cannot continue.

        """
        problem, last = self.problem, self.observed.last
        if last and self._described != len(self.observed):
            self._described = len(self.observed)
            self._bound = self._bound_after(last)
            self._pending.clear()
            if isinstance(self._method, SampleMethod):
                self._drawn = self._histograms(self._method)
            else:
                self._surfaces = band.surfaces(self.plan, self._method, self._bound, self._worst_start)
            self.charts = charts_after(
                self.charts, self.plan, self._method, self._bound, self.observed, read=self._read
            )
            self.fed = self._method, self._bound
            self._tests = observed_series(self.plan, self.observed)
            self._warnings = self._contradictions()
        now = self._bound if last else None
        stopped_by = result.stopped_by if result else self._stopped_by(last)
        bound = result.bound if result else signed(now.upper if now else None, self._sense)
        limit = by_clip(self._config, problem)  # the bound is never weaker than the clip, as in the certificate
        return Problem(
            name=problem.name,
            objective=typeset(result.objective if result else objective(self.plan, bound)),
            quantity=self.plan.statement.quantity,
            method=problem.method,
            sense=self._sense,
            unit=unit(problem, self._config, self._header.spec),
            distance="F_i" if problem.method == "paper" else "U - L",
            alpha=alpha_of(self._config, problem),
            delta=problem.delta,
            bound=None if bound is None else floored(bound, self._sense, limit),
            partner=result.partner if result else self._partner(),
            probability=result.probability if result else self._probability(last),
            budget=self._extended or self.plan.budget,
            rollouts=self.rollouts,
            stopped_by=stopped_by,
            left=None if stopped_by else self._left(),
            outlook=_outlook(
                self._config,
                self.plan,
                self.observed,
                rollouts=self.rollouts,
                extended=self._extended,
                planned=self._planned,
            )
            if len(self.observed) and not self._own
            else None,
            surfaces=self._surfaces,
            tests=self._tests,
            by_clip=limit,
            clipped=self.plan.hidden_by(bound=bound),
            warnings=self._warnings,
            starts=self.plan.listed,
            drawn=self._drawn[0] if self._drawn else None,
            requirements=tuple(self._drawn[1:]),
            requirement=self.plan.requirement,
            observed=len(self.observed),
        )

    def regions(self, directory: Path, predicate: Predicate | None) -> RegionMap | None:
        """Return the regions of a finished campaign; None for any other."""
        if predicate is None or predicate.regions is None or not len(self.observed):
            return None
        return region_map(directory, self.plan, predicate, self._worst_start)

    @property
    def ended_by_counterexample(self) -> ObservedTest | None:
        """The last test, if a rollout of it ended the campaign."""
        last = self.observed.last
        return last if last and last.stopped_by == "counterexample" else None

    def worst_tests(self, number: int) -> list[int]:
        """Return the worst test of each of the worst `number` starts, the worst first."""
        found, order = dict[tuple[float, ...], int](), worst_first(self.plan, self.observed)
        for first in range(0, len(order), SOME):  # of very many tests the first have as many starts
            some = order[first : first + SOME]
            for test, x in zip(some.tolist(), self.observed.x[some].tolist(), strict=True):
                found.setdefault(tuple(x), test)
            if len(found) >= number:
                break
        return list(found.values())[:number]

    @property
    def _worst_start(self) -> tuple[float, ...]:
        return self.observed[int(worst_first(self.plan, self.observed)[0])].proposal.x

    def _bound_after(self, last: ObservedTest) -> Bound:
        """Give the pending observations to the method and return the bound after them, which is that of `last`."""
        blocks = [each for each in self._pending if isinstance(each, BlockObservationFact)]
        if blocks:
            nodes = np.concatenate([self.proposed.block(each.test).nodes for each in blocks])
            y, contributions = [each.y for each in blocks], [each.contributions for each in blocks]
            self._method.recall_each(nodes, np.concatenate(y), np.concatenate(contributions))
        tests = [
            (self.proposed.proposal(each.test), each.observation)
            for each in self._pending
            if isinstance(each, ObservationFact)
        ]
        if self._own is None:
            if not blocks:
                self._method.recall(tests)
            return last.bound
        assert isinstance(self._method, PartMethod), "no other method bounds each requirement"
        return self._method.bound_after(tests)

    def _partner(self) -> float | None:
        # That of the largest objective is false if any of theirs is: no single delta covers it.
        return signed(self._bound.lower, self._sense) if self._bound and not self.plan.parts else None

    def _stopped_by(self, last: ObservedTest | None) -> StoppedBy | None:
        # A requirement may be done before the others are.
        verdict = self._bound.verdict if self._bound and self._own else None
        return verdict or (last.stopped_by if last else None)

    def _histograms(self, method: SampleMethod) -> list[Drawn]:
        tests, unit = drawn_tests(self.plan, self.observed), robustness_unit(self._config, self._header.spec)
        # A search may have found its counterexample before the first drawn start.
        return histograms(self.plan, method, tests, self.observed.each[tests], unit) if len(tests) else []

    def _probability(self, last: ObservedTest | None) -> float | None:
        """Return the probability of the current bound; None where there is no valid one."""
        if last is None or last.stopped_by == "refuted":
            return None
        if self.problem.bound_at_end and last.stopped_by is None:
            return None
        return self._method.probability

    def _contradictions(self) -> tuple[str, ...]:
        values, number = self.observed.each, self.plan.replicates
        robustness = consistency.robustness_of(self.problem, values[:, :number][~np.isnan(values[:, :number])])
        each = self.observed.of_replicates(number)
        found = consistency.of_tests(self.plan, self.observed.y.tolist(), each, robustness.tolist())
        return tuple(map(typeset, (*consistency.of_plan(self.plan, self._header.spec), *found.values())))

    def _left(self) -> str | None:
        if self._own is not None or not len(self.observed):
            return None  # its tests are those of the whole
        left = remaining_tests(self._config, self.problem, _progress_of(self.observed, self.rollouts, self._extended))
        return None if left is None else left_in_words(self._config, self.problem, left)


def drawn_tests(plan: ProblemPlan, observed: ObservedTests) -> NDArray[np.intp]:
    """Return the numbers of the observed tests whose starts are drawn."""
    tests = np.arange(len(observed))
    # Without a search every one: a million is not asked for one by one.
    return tests if plan.falsify is None else tests[[plan.is_drawn(test) for test in tests.tolist()]]


def _of_requirement(fact: Observed, own: Own) -> Observed:
    """Return the observations of one requirement in those of the whole."""
    if isinstance(fact, ObservationFact):
        return replace(fact, observation=own(fact.observation))
    found = [own(each.observation) for each in fact.each()]
    y, each = np.array([one.y for one in found]), np.array([one.each for one in found])
    return BlockObservationFact.of(fact.problem, fact.test, y, each)


def _progress_of(observed: ObservedTests, rollouts: int, extended: int | None) -> ProblemProgress:
    marked = (observed[tests - 1] for tests in sorted(MARKED) if tests <= len(observed))
    points = ((each.test + 1, each.bound.upper, distance_after(each.bound, each.proposal.F)) for each in marked)
    course = tuple((tests, upper, away) for tests, upper, away in points if upper is not None)
    last = observed[-1]
    return ProblemProgress(len(observed), rollouts, last.proposal.F, last.bound, last.stopped_by, extended, course)


def _outlook(
    config: CampaignConfig,
    plan: ProblemPlan,
    observed: ObservedTests,
    *,
    rollouts: int,
    extended: int | None,
    planned: Callable[[ProblemProgress], tuple[Guess, Guess] | None],
) -> str | None:
    progress = _progress_of(observed, rollouts, extended)
    return in_words(config, plan.problem, replace(progress, planned=planned(progress)))
