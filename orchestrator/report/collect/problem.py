"""The part of the collector for one problem, or for one of its requirements: its tests, and its method fed with them.

Facts are in terms of the maximised objective J; the data carry the sign of the problem's own objective, so upper and
lower change places for a minimum.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from ....schemas.file.config import CampaignConfig
from ....schemas.file.parts import alpha_of
from ....schemas.result.certificate import Predicate, ProblemResult
from ....schemas.result.facts import BoundFact, ExtensionFact, Header, ObservationFact, ProposalFact
from ....schemas.values import MARKED, Bound, Guess, Observation, ProblemProgress, Proposal, StoppedBy, distance_after
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
from . import band, importance, limits
from .drawn import histograms
from .observed import observed_series, signed, worst_first
from .regions import region_map
from .wording import typeset


def empty_charts(config: CampaignConfig, plan: ProblemPlan) -> ProblemCharts:
    """Return the charts of a problem before its first test; `config` is that of the campaign."""
    return ProblemCharts(
        required=limits.required(config, plan), of_robustness=limits.is_robustness(plan), clip=limits.ends(plan)
    )


def charts_after(
    charts: ProblemCharts, plan: ProblemPlan, method: ProblemMethod, bound: Bound, observed: Sequence[ObservedTest]
) -> ProblemCharts:
    """Return the charts of a problem after its last observed test, whose bound is `bound`."""
    if isinstance(method, SampleMethod):
        drawn = [each for each in observed if plan.is_drawn(each.test)]
        starts, values = [each.proposal.x for each in drawn], [each.observation.each[0] for each in drawn]
        return replace(charts, importance=importance.of_drawn_tests(starts, values))
    uncut = np.array(method.band(bound).mean)
    mean = limits.within(uncut, plan)
    beyond = ~np.isnan(uncut) & (uncut != mean)
    of_model = importance.of_model(plan, mean if plan.sense == "max" else 0.0 - mean)
    return replace(charts, importance=of_model, overshoots=float(beyond.mean()))


Own = Callable[[Observation], Observation]
"""The observation of one requirement in that of a test."""


class ProblemCollector:
    """The facts of one problem so far; surface and columns are computed again only after a new bound.

    A requirement that is bounded on its own has the tests of the problem, of which `own` returns its observation; its
    bound is not recorded, and follows from them. `config` is the campaign of what is bounded.
    """

    def __init__(self, header: Header, plan: ProblemPlan, config: CampaignConfig, own: Own | None = None) -> None:
        self.problem = plan.problem
        self.rollouts = 0
        self.starts: list[tuple[float, ...]] = []
        """z of every proposed test."""
        self.observed: list[ObservedTest] = []
        self.plan, self._method, self._header = plan, method(plan, header), header
        self._config, self._own = config, own
        self._bound: Bound | None = None
        self._sense = plan.sense
        self._proposals: dict[int, ProposalFact] = {}
        self._values: dict[int, ObservationFact] = {}
        self._pending: list[tuple[Proposal, Observation]] = []
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
            KeyError: an earlier fact is missing.

        """
        match fact:
            case ProposalFact():
                self._proposals[fact.test] = fact
                self.starts.append(fact.proposal.x)
            case ObservationFact():
                fact = fact if self._own is None else replace(fact, observation=self._own(fact.observation))
                if self.plan.is_evidence(fact.test):
                    self._pending.append((self._proposals[fact.test].proposal, fact.observation))
                self._values[fact.test] = fact
            case BoundFact():
                fact = fact if self._own is None else replace(fact, bound=Bound(None, None, fact.bound.verdict))
                for test in range(len(self.observed), fact.test + 1):  # several where it is that of a block
                    proposal, observation = self._proposals.pop(test), self._values.pop(test)
                    self.observed.append(ObservedTest.of(proposal, observation, fact))

    def extend(self, fact: ExtensionFact) -> None:
        """Take an extension of the campaign: with a larger budget the last bound is no end any more."""
        budget = dict(fact.budgets).get(self.problem.name)
        self._extended = budget or self._extended
        if budget and self.observed:
            self.observed[-1] = replace(self.observed[-1], stopped_by=None)

    def data(self, result: ProblemResult | None) -> Problem:
        """Return the data of the problem; `result` is its part of the certificate.

        Raises:
            ValueError: the method cannot continue.

        """
        problem, last = self.problem, self.observed[-1] if self.observed else None
        if last and self._described != len(self.observed):
            self._described = len(self.observed)
            self._bound = self._bound_after(last)
            self._pending.clear()
            if isinstance(self._method, SampleMethod):
                self._drawn = self._histograms(self._method)
            else:
                self._surfaces = band.surfaces(self.plan, self._method, self._bound, self._worst_start)
            self.charts = charts_after(self.charts, self.plan, self._method, self._bound, self.observed)
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
            if self.observed and not self._own
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
        if predicate is None or predicate.regions is None or not self.observed:
            return None
        return region_map(directory, self.plan, predicate, self._worst_start)

    @property
    def ended_by_counterexample(self) -> ObservedTest | None:
        """The last test, if a rollout of it ended the campaign."""
        last = self.observed[-1] if self.observed else None
        return last if last and last.stopped_by == "counterexample" else None

    def worst_tests(self, number: int) -> list[int]:
        """Return the worst test of each of the worst `number` starts, the worst first."""
        found: dict[tuple[float, ...], int] = {}
        for each in worst_first(self.plan, self.observed):
            found.setdefault(each.proposal.x, each.test)
        return list(islice(found.values(), number))

    @property
    def _worst_start(self) -> tuple[float, ...]:
        return worst_first(self.plan, self.observed)[0].proposal.x

    def _bound_after(self, last: ObservedTest) -> Bound:
        """Give the pending observations to the method and return the bound after them, which is that of `last`."""
        if self._own is None:
            self._method.recall(self._pending)
            return last.bound
        assert isinstance(self._method, PartMethod), "no other method bounds each requirement"
        return self._method.bound_after(self._pending)

    def _partner(self) -> float | None:
        # That of the largest objective is false if any of theirs is: no single delta covers it.
        return signed(self._bound.lower, self._sense) if self._bound and not self.plan.parts else None

    def _stopped_by(self, last: ObservedTest | None) -> StoppedBy | None:
        # A requirement may be done before the others are.
        verdict = self._bound.verdict if self._bound and self._own else None
        return verdict or (last.stopped_by if last else None)

    def _histograms(self, method: SampleMethod) -> list[Drawn]:
        header = self._header
        values = {each.test: each.observation.each for each in self.observed if self.plan.is_drawn(each.test)}
        # A search may have found its counterexample before the first drawn start.
        return histograms(self.plan, method, values, robustness_unit(self._config, header.spec)) if values else []

    def _probability(self, last: ObservedTest | None) -> float | None:
        """Return the probability of the current bound; None where there is no valid one."""
        if last is None or last.stopped_by == "refuted":
            return None
        if self.problem.bound_at_end and last.stopped_by is None:
            return None
        return self._method.probability

    def _contradictions(self) -> tuple[str, ...]:
        each = [test.observation.each[: self.plan.replicates] for test in self.observed]
        y = [test.observation.y for test in self.observed]
        robustness = consistency.robustness_of(self.problem, each)
        found = consistency.of_tests(self.plan, y, each, robustness)
        return tuple(map(typeset, (*consistency.of_plan(self.plan, self._header.spec), *found.values())))

    def _left(self) -> str | None:
        if self._own is not None or not self.observed:
            return None  # its tests are those of the whole
        left = remaining_tests(self._config, self.problem, _progress_of(self.observed, self.rollouts, self._extended))
        return None if left is None else left_in_words(self._config, self.problem, left)


def _progress_of(observed: Sequence[ObservedTest], rollouts: int, extended: int | None) -> ProblemProgress:
    marked = (each for each in observed if each.test + 1 in MARKED)
    points = ((each.test + 1, each.bound.upper, distance_after(each.bound, each.proposal.F)) for each in marked)
    course = tuple((tests, upper, away) for tests, upper, away in points if upper is not None)
    last = observed[-1]
    return ProblemProgress(len(observed), rollouts, last.proposal.F, last.bound, last.stopped_by, extended, course)


def _outlook(
    config: CampaignConfig,
    plan: ProblemPlan,
    observed: Sequence[ObservedTest],
    *,
    rollouts: int,
    extended: int | None,
    planned: Callable[[ProblemProgress], tuple[Guess, Guess] | None],
) -> str | None:
    progress = _progress_of(observed, rollouts, extended)
    return in_words(config, plan.problem, replace(progress, planned=planned(progress)))
