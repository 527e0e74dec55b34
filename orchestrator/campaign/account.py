"""The account of a problem: the series of its tests, and what its audit needs of their rollouts."""

import math
from array import array
from collections.abc import MutableSequence
from dataclasses import dataclass, field, replace

from ...schemas.file.problem_models import KernelProblem
from ...schemas.result.facts import ExtensionFact, ObservationFact, RolloutFact, extended_link
from ...schemas.values import Observation, Proposal
from . import objectives
from .plan import ProblemPlan
from .series import Series


@dataclass(slots=True)
class Account(Series):
    """The facts of one problem."""

    plan: ProblemPlan = field(kw_only=True)
    proposed: list[Proposal] = field(default_factory=list)
    """The proposals of the closed tests, where a kernel method may be given them again; its kernel rows cost more."""
    excess: float = -math.inf
    """Of a gap: the most by which a robustness differed beyond L times the gap; above 0 it dominates nothing."""
    robustness: MutableSequence[float] = field(default_factory=lambda: array("d"))

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

    def extend(self, fact: ExtensionFact) -> None:
        """Take an extension of the campaign."""
        # In the chain of every problem: one extension and two in steps differ, even where all rollouts are equal.
        self.link = extended_link(self.link, fact)
        budget = dict(fact.budgets).get(self.plan.name)
        if budget is not None:
            self.budgets.append(budget)
            # The bound stays as it is, but is no end any more.
            self.last_bound = replace(self.last_bound, budget=False) if self.last_bound else None

    def observe(self, fact: ObservationFact) -> list[RolloutFact]:
        """Close an observed test, as every series does, and take the robustness of its rollouts."""
        rollouts = Series.observe(self, fact)  # by name: `super()` finds no cell in a class with slots
        if isinstance(self.plan.problem, KernelProblem) and self.last_proposal is not None:
            self.proposed.append(self.last_proposal)
        if self.plan.objective.measured == "gap":
            # The composition needs a gap that dominates the robustness difference in every pair: checked by the audit.
            robustness = {(each.rollout.variant, each.rollout.replicate): each.robustness or 0.0 for each in rollouts}
            self.excess = max(self.excess, objectives.excess(self.plan, robustness, fact.observation.each))
        for rollout in rollouts:
            if rollout.robustness is not None:
                self.robustness.append(rollout.robustness)
        return rollouts
