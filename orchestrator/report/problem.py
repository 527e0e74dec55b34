"""The part of the collector for one problem, or for one of its requirements: its tests, and its method fed with them.

Facts are in terms of the maximised objective J; the data carry the sign of the problem's own objective, so upper and
lower change places for a minimum.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path

from ...schemas.campaign import CampaignConfig
from ...schemas.certificate import Counterexample, Predicate, ProblemResult
from ...schemas.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ...schemas.values import Bound, Observation, Proposal, StoppedBy
from ..campaign import consistency, forecast
from ..campaign.clip import by_clip, floored
from ..campaign.methods import PartMethod, method
from ..campaign.plan import ProblemPlan
from ..certificate.problem_results import objective
from ..mathematics.bounds.sample import SampleMethod
from ..store.changes import Decision
from ..store.export_tables import robustness_unit, unit
from ..store.read import ObservedTest
from . import band
from .data import Drawn, Problem, RegionMap, Surface, TestSeries
from .drawn import histograms
from .regions import region_map
from .wording import typeset

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
        self._plan, self._method, self._header = plan, method(plan, header), header
        self._config, self._own = config, own
        self._bound: Bound | None = None
        self._sense = plan.sense
        self._proposals: dict[int, ProposalFact] = {}
        self._values: dict[int, ObservationFact] = {}
        self._pending: list[tuple[Proposal, Observation]] = []
        """Observations not yet passed to the method."""
        self._surfaces: tuple[Surface, ...] = ()
        self._drawn: list[Drawn] = []
        self._tests = self._columns()
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
                if self._plan.is_evidence(fact.test):
                    self._pending.append((self._proposals[fact.test].proposal, fact.observation))
                self._values[fact.test] = fact
            case BoundFact():
                fact = fact if self._own is None else replace(fact, bound=Bound(None, None, fact.bound.verdict))
                proposal, observation = self._proposals.pop(fact.test), self._values.pop(fact.test)
                self.observed.append(ObservedTest.of(proposal, observation, fact))

    def data(self, result: ProblemResult | None) -> Problem:
        """Return the data of the problem; `result` is its part of the certificate.

        Raises:
            ValueError: the method cannot continue.

        """
        problem, last = self.problem, self.observed[-1] if self.observed else None
        if last and len(self._tests.test) != len(self.observed):
            self._bound = self._bound_after(last)
            self._pending.clear()
            if isinstance(self._method, SampleMethod):
                self._drawn = self._histograms(self._method)
            else:
                self._surfaces = band.surfaces(self._plan, self._method, self._bound, self._worst.proposal.x)
            self._tests = self._columns()
            self._warnings = self._contradictions()
        now = self._bound if last else None
        stopped_by = result.stopped_by if result else self._stopped_by(last)
        bound = result.bound if result else signed(now.upper if now else None, self._sense)
        rules = self._header.rules
        later = rules >= 2  # the bound is then never weaker than the clip, as in the certificate
        limit = by_clip(self._config, problem) if later else None
        return Problem(
            name=problem.name,
            objective=typeset(result.objective if result else objective(self._plan, rules)),
            quantity=self._plan.statement.quantity,
            method=problem.method,
            sense=self._sense,
            unit=unit(problem, self._config, self._header.spec),
            distance="F_i" if problem.method == "paper" else "U - L",
            alpha=problem.alpha,
            delta=problem.delta,
            bound=None if bound is None else floored(bound, self._sense, limit),
            partner=result.partner if result else signed(now.lower if now else None, self._sense),
            probability=result.probability if result else self._probability(last),
            budget=self._plan.budget,
            rollouts=self.rollouts,
            stopped_by=stopped_by,
            left=None if stopped_by else self._left(),
            surfaces=self._surfaces,
            tests=self._tests,
            by_clip=limit,
            warnings=self._warnings,
            starts=self._plan.listed if rules > 1 else None,
            drawn=self._drawn[0] if self._drawn else None,
            requirements=tuple(self._drawn[1:]),
            requirement=self._plan.requirement,
        )

    def regions(self, directory: Path, predicate: Predicate | None) -> RegionMap | None:
        """Return the regions of a finished campaign; None for any other."""
        if predicate is None or predicate.regions is None or not self.observed:
            return None
        return region_map(directory, self._plan, predicate, self._worst.proposal.x)

    @property
    def ended_by_counterexample(self) -> ObservedTest | None:
        """The last test, if a rollout of it ended the campaign."""
        last = self.observed[-1] if self.observed else None
        return last if last and last.stopped_by == "counterexample" else None

    def counterexample(self, worst: RolloutFact) -> Counterexample:
        """Return the counterexample before the certificate has it; `worst` is the worst rollout of its test."""
        return Counterexample(
            rollout=str(worst.rollout),
            test=worst.rollout.test,
            rollouts=len(self._plan.rollouts),
            start=dict(zip(self._plan.parameters, self.starts[worst.rollout.test], strict=True)),
            seed=worst.seed,
            robustness=worst.robustness or 0.0,
        )

    def worst_tests(self, number: int) -> list[int]:
        """Return the worst test of each of the worst `number` starts, the worst first."""
        found: dict[tuple[float, ...], int] = {}
        for each in sorted(self.observed, key=self._goodness):
            found.setdefault(each.proposal.x, each.test)
        return list(islice(found.values(), number))

    @property
    def _worst(self) -> ObservedTest:
        return min(self.observed, key=self._goodness)

    def _goodness(self, test: ObservedTest) -> tuple[float, int]:
        return -self._badness(test.observation), test.test

    def _bound_after(self, last: ObservedTest) -> Bound:
        """Give the pending observations to the method and return the bound after them, which is that of `last`."""
        if self._own is None:
            self._method.recall(self._pending)
            return last.bound
        assert isinstance(self._method, PartMethod), "no other method bounds each requirement"
        return self._method.bound_after(self._pending)

    def _stopped_by(self, last: ObservedTest | None) -> StoppedBy | None:
        # A requirement may be done before the others are.
        verdict = self._bound.verdict if self._bound and self._own else None
        return verdict or (last.stopped_by if last else None)

    def _badness(self, observation: Observation) -> float:
        """Return J, which is maximised; where starts are drawn the worst robustness, whatever is bounded."""
        return -min(observation.each[: self._plan.replicates]) if self._plan.candidates is None else observation.y

    def _histograms(self, method: SampleMethod) -> list[Drawn]:
        header = self._header
        values = {each.test: each.observation.each for each in self.observed if self._plan.is_drawn(each.test)}
        # A search may have found its counterexample before the first drawn start.
        return histograms(self._plan, method, values, robustness_unit(self._config, header.spec)) if values else []

    def _probability(self, last: ObservedTest | None) -> float | None:
        """Return the probability of the current bound; None where there is no valid one."""
        if last is None or last.stopped_by == "refuted":
            return None
        # Method paper claims its bound only for the test at which it stops.
        if self.problem.method == "paper" and last.stopped_by is None:
            return None
        return self._method.probability

    def _contradictions(self) -> tuple[str, ...]:
        each = [test.observation.each[: self._plan.replicates] for test in self.observed]
        y = [test.observation.y for test in self.observed]
        robustness = consistency.robustness_of(self.problem, each)
        found = consistency.of_tests(self._plan, y, each, robustness)
        return tuple(map(typeset, (*consistency.of_plan(self._plan, self._header.spec), *found.values())))

    def _left(self) -> str | None:
        if self._own is not None:
            return None  # its tests are those of the whole
        now = self._tests.distance[-1] if self._tests.distance else None
        left = forecast.tests_left(self._config, self.problem, now, len(self.observed))
        return None if left is None else forecast.left_in_words(self._config, self.problem, left)

    @property
    def _observed_sense(self) -> str:
        return "min" if self._plan.candidates is None else self._sense

    def _columns(self) -> TestSeries:
        tests, sense = self.observed, self._sense
        upper = tuple(signed(each.bound.upper, sense) for each in tests)
        lower = tuple(signed(each.bound.lower, sense) for each in tests)
        return TestSeries(
            test=tuple(each.test for each in tests),
            x=tuple(each.proposal.x for each in tests),
            y=tuple(signed(self._badness(each.observation), self._observed_sense) for each in tests),
            distance=tuple(forecast.distance(self.problem, each.proposal.F, each.bound) for each in tests),
            lower=upper if sense == "min" else lower,
            upper=lower if sense == "min" else upper,
        )


def signed(value: float | None, sense: str) -> float | None:
    """Return a value of J with the sign of the objective.

    >>> signed(0.25, "min"), signed(0.25, "max"), signed(0.0, "min")
    (-0.25, 0.25, 0.0)
    """
    # 0.0 - value: -0.0 would be printed as a negative number
    return value if value is None or sense == "max" else 0.0 - value
