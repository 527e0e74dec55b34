"""The check of the risk itself at a named start: is it below the bound that the spot check refutes there?

Where a method bounds the risk by the expectation of its linearised variable X, the spot check tests E[X(d)] >= ell. A
violation refutes what the bound rests on; but E[X] <= risk, so the sentence about the risk may still be true at d.
Fresh rollouts there decide it, of what the spot check has left of its follow-ups: the start was chosen before them, so
that their bound needs no union over the starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from ....schemas.ids import RISK_CHECK, RolloutId, of_extension
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Bound, Observation, Proposal
from ...mathematics.bounds.one_law.risk_upper import RiskUpperBound
from .. import state
from ..decisions import UNOBSERVABLE, naming
from ..observation import Others, Trajectories
from ..plan import ProblemPlan
from ..seeds import rollout_seed
from ..series import Series
from .spot_check import WINDOW, SpotCheck


@dataclass(slots=True)
class NamedRisk:
    """A bound of a risk that the spot check refutes at a start, and the rollouts of the check there."""

    plan: ProblemPlan
    start: int
    limit: float
    """The refuted lower bound, in the unit of the robustness."""
    bound: RiskUpperBound

    @property
    def is_below(self) -> bool:
        """Whether the risk at the start is below the limit."""
        return self.bound.upper < self.limit


class RiskCheck:
    """The decider of the check; a test has `spot_replicates` rollouts of the true system at one named start.

    `each` of an observation has minus the robustness for each refuted bound, in the order of the campaign file, for
    each replicate.
    """

    def __init__(
        self, header: Header, spot: SpotCheck, named: Sequence[NamedRisk], budget: int, extensions: int = 0
    ) -> None:
        self.name = of_extension(RISK_CHECK, extensions)
        self.named = tuple(named)
        self._header, self._observer, self._starts = header, spot.observer, spot.starts
        (self._variant,) = self.named[0].plan.variants  # that of every risk
        rollouts = tuple((self._variant, replicate) for replicate in range(header.config.spot_replicates))
        self.plan = state.Plan(self.name, min(WINDOW, budget), budget, rollouts)

    @classmethod
    def of(cls, header: Header, spot: SpotCheck, spent: int, extensions: int = 0) -> "RiskCheck | None":
        """Return the check that follows a spot check of so many tests; None where nothing is to be decided, or left."""
        named = _refuted_risks(spot)
        # What the spot check has left of its follow-ups: the campaign file limits both together.
        budget = spot.plan.most_tests - spent
        return cls(header, spot, named, budget, extensions) if named and budget > 0 else None

    def proposal(self, series: Series, test: int) -> ProposalFact:
        """Choose the undecided start with the fewest rollouts, those in flight included."""
        flying = [fact.proposal.node for fact in series.proposals.values()]
        tests = [series.nodes.count(each.start) + flying.count(each.start) for each in self.named]
        # The window is kept full: where all are decided the check ends with the next observation.
        open_first = sorted(range(len(self.named)), key=lambda k: (self.named[k].is_below, tests[k], k))
        start = self.named[open_first[0]].start
        return ProposalFact(self.name, test, Proposal(start, self._starts[start], None, None, None, None))

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Return minus the robustness for every refuted bound, for each replicate; y is the first one."""
        ordered = [trajectories[self._variant, replicate] for replicate in range(len(self.plan.rollouts))]
        with naming(f"{self.name}, test {test}", UNOBSERVABLE):
            values = tuple(-self._robustness(named, each) for each in ordered for named in self.named)
        found = Observation(values[0], values)
        return ObservationFact(self.name, test, found, series.next_link(test, found))

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:
        """Do nothing: the robustness of every rollout is computed when it is admitted."""

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:
        """Take an observation; the check ends with its budget, or when every risk is known to be below its bound."""
        assert series.last_proposal is not None
        values, width = fact.observation.each, len(self.named)
        with naming(f"{self.name}, test {fact.test}"):
            for place, named in enumerate(self.named):
                if named.start == series.last_proposal.node:
                    for value in values[place::width]:
                        named.bound.add(-value)
        spent = fact.test + 1 >= self.plan.max_tests
        done = all(each.is_below for each in self.named)
        return BoundFact(self.name, fact.test, Bound(None, None, "converged" if done else None), budget=spent)

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of a rollout."""
        return rollout_seed(self._header, rollout)

    def finding(self, key: str) -> NamedRisk | None:
        """Return the finding for the bound of a problem, by its key; None where the check is not about it."""
        return next((each for each in self.named if each.plan.key == key), None)

    def _robustness(self, named: NamedRisk, trajectory: Trajectory) -> float:
        found = self._observer.robustness_of(named.plan, trajectory)
        assert found is not None, "a risk is one of the robustness"
        return found


def _refuted_risks(spot: SpotCheck) -> list[NamedRisk]:
    """Return the refuted bounds of a risk by way of X, each with its start; a refuted mean needs no further rollout."""
    found = []
    for plan, finding in spot.findings():
        hypothesis = spot.hypotheses[plan.key]
        if finding.status == "refuted" and finding.start is not None and hypothesis.noisy and _is_linearised(plan):
            # Fresh rollouts at the whole level: those that named the start would have to share it among all starts.
            bound = RiskUpperBound(plan.clip, plan.risk_weight, delta=spot.level)
            found.append(NamedRisk(plan, finding.start, -hypothesis.limit, bound))
    return found


def _is_linearised(plan: ProblemPlan) -> bool:
    """Whether the variable that is bounded, and tested, has an expectation below the risk and is not the robustness."""
    return plan.objective.risk and plan.problem.method != "paper" and plan.problem.observed_through is not None
