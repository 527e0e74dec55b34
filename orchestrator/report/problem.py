"""One problem of the story, from the facts so far: its tests, its method fed with them, and what both say.

Facts speak of the maximised objective J; the story has the objective's own sign, so for a minimum upper and lower
change places.
"""

from itertools import islice

from ...schemas import campaign as schema
from ...schemas.campaign import SENSES
from ...schemas.certificate import ProblemResult
from ...schemas.facts import BoundFact, Header, ObservationFact, ProposalFact
from ...schemas.values import Observation, Proposal
from ..campaign import forecast
from ..campaign.methods import method
from ..campaign.plan import ProblemPlan
from ..certificate.results import objective
from ..store.changes import Decision
from ..store.export_tables import unit
from ..store.read import ObservedTest
from . import band
from .data import Problem, Surface, TestSeries


class ProblemCollector:
    """What has been told of one problem so far."""

    def __init__(self, header: Header, plan: ProblemPlan) -> None:
        self.problem = problem = plan.problem
        self._plan, self._method = plan, method(plan)
        self.sense = SENSES[problem.name]
        self.rollouts = 0
        self.starts: list[tuple[float, ...]] = []
        """z of every proposed test."""
        self.observed: list[ObservedTest] = []
        self._header = header
        self._proposals: dict[int, ProposalFact] = {}
        self._values: dict[int, ObservationFact] = {}
        self._unread: list[tuple[Proposal, Observation]] = []
        self._surface: tuple[int, Surface | None] = (0, None)
        self._tests: tuple[int, TestSeries] = (0, _columns(problem, self.sense, ()))

    def take(self, fact: Decision) -> None:
        """Add the next fact of this problem.

        Raises:
            KeyError: an earlier fact is missing.

        """
        match fact:
            case ProposalFact():
                self._proposals[fact.test] = fact
                self.starts.append(fact.proposal.x)
            case ObservationFact():
                self._unread.append((self._proposals[fact.test].proposal, fact.observation))
                self._values[fact.test] = fact
            case BoundFact():
                proposal, observation = self._proposals.pop(fact.test), self._values.pop(fact.test)
                self.observed.append(ObservedTest.of(proposal, observation, fact))

    @property
    def last(self) -> ObservedTest | None:
        """The last observed test."""
        return self.observed[-1] if self.observed else None

    def told(self, result: ProblemResult | None) -> Problem:
        """Return it for the story; `result` is what the certificate says of it."""
        problem, last = self.problem, self.last
        tests = self.tests()
        bound, partner = _sides(self.sense, last)
        stopped = last.stopped_by if last else None
        return Problem(
            name=problem.name,
            objective=result.objective if result else objective(self._plan),
            method=problem.method,
            sense=self.sense,
            unit=unit(problem, self._header.config, self._header.spec),
            distance="F_i" if problem.method == "paper" else "U - L",
            alpha=problem.alpha,
            delta=problem.delta,
            bound=result.bound if result else bound,
            partner=result.partner if result else partner,
            probability=result.probability if result else self._probability(),
            budget=self._plan.budget,
            rollouts=self.rollouts,
            stopped_by=stopped,
            left=None if stopped else self._left(),
            surface=self.surface(),
            tests=tests,
        )

    def tests(self) -> TestSeries:
        """Return the columns; they are made again only after a new test."""
        if self._tests[0] != len(self.observed):
            self._tests = (len(self.observed), _columns(self.problem, self.sense, tuple(self.observed)))
        return self._tests[1]

    def surface(self) -> Surface | None:
        """Return the band over D; it is worked out again only after a new test.

        Raises:
            ValueError: the method cannot go on.

        """
        if self.last is not None and self._surface[0] != len(self.observed):
            self._method.recall(self._unread)
            self._unread.clear()
            found = band.surface(self._plan, self._method, self.last.bound)
            self._surface = (len(self.observed), found)
        return self._surface[1]

    def worst(self, number: int) -> list[int]:
        """Return the worst test of each of the worst starts, the worst first."""
        order = sorted(
            self.observed, key=lambda test: (-test.observation.y, test.test)
        )  # y is of J, which is maximised
        found: dict[tuple[float, ...], int] = {}
        for each in order:
            found.setdefault(each.proposal.x, each.test)
        return list(islice(found.values(), number))

    def _probability(self) -> float | None:
        """Return the probability with which the bound holds now; method paper has a bound only once it has stopped."""
        if self.last is None or self.last.stopped_by == "refuted":
            return None
        if self.problem.method == "paper" and self.last.stopped_by is None:
            return None
        return self._method.probability

    def _left(self) -> str | None:
        distance = self.tests().distance
        now = distance[-1] if distance else None
        left = forecast.tests_left(self._header.config, self.problem, now, len(self.observed))
        return None if left is None else f"about {left} test{'' if left == 1 else 's'}"


def signed(value: float | None, sense: str) -> float | None:
    """Return a value of J with the sign of the objective.

    >>> signed(0.25, "min"), signed(0.25, "max"), signed(0.0, "min")
    (-0.25, 0.25, 0.0)
    """
    return value if value is None or sense == "max" else 0.0 - value


def _sides(sense: str, last: ObservedTest | None) -> tuple[float | None, float | None]:
    """Return the bound of the certificate's side, and the one from the other side."""
    return (None, None) if last is None else (signed(last.bound.upper, sense), signed(last.bound.lower, sense))


def _columns(problem: schema.Problem, sense: str, tests: tuple[ObservedTest, ...]) -> TestSeries:
    upper, lower = (
        tuple(signed(each.bound.upper, sense) for each in tests),
        tuple(signed(each.bound.lower, sense) for each in tests),
    )
    return TestSeries(
        test=tuple(each.test for each in tests),
        x=tuple(each.proposal.x for each in tests),
        y=tuple(signed(each.observation.y, sense) for each in tests),
        distance=tuple(forecast.distance(problem, each.proposal.F, each.bound) for each in tests),
        lower=upper if sense == "min" else lower,
        upper=lower if sense == "min" else upper,
    )
