"""The charts of the problems of one campaign, from all that was read of it so far."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...schemas.campaign import CampaignConfig
from ...schemas.certificate import Predicate
from ...schemas.facts import Header
from ...schemas.values import Bound
from ..campaign.methods import ProblemMethod
from ..campaign.plan import ProblemPlan
from ..mathematics.bounds.sample import SampleMethod
from ..store.export_tables import robustness_unit
from ..store.read import ObservedTest
from ..store.rollout_values import RolloutValueReader
from . import importance, limits
from .chart_data import Prediction, ProblemCharts
from .prediction import FreshStarts, prediction
from .rollout_histogram import RolloutValues


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


class LaterCharts:
    """What the charts need beyond the facts of their problem: all rollouts, and the spot check. Not thread-safe."""

    def __init__(self, directory: Path) -> None:
        self._reader, self._values = RolloutValueReader(directory), RolloutValues()
        self._spot = FreshStarts()
        self._predicted: dict[str, Prediction | None] = {}

    def add(self, fact: object) -> None:
        """Add a fact of a closing check."""
        self._spot.add(fact)

    def refresh(self) -> None:
        """Read the rollouts that were added.

        Raises:
            JournalError: there is no campaign, or its database is damaged.

        """
        self._values.add(self._reader.read())

    def reopen(self) -> None:
        """Forget what followed from a certificate, because the campaign was extended."""
        self._predicted.clear()

    def of(
        self,
        charts: ProblemCharts,
        plan: ProblemPlan,
        header: Header,
        predicate: Predicate | None,
        fed: tuple[ProblemMethod, Bound] | None,
    ) -> ProblemCharts:
        """Return the charts of a problem, complete; `fed` is its method with all observations, and the last bound."""
        spot = predicate.spot_check if predicate else None
        # A certificate is final, and so is what its model predicted.
        if spot is not None and fed is not None and plan.key not in self._predicted:
            self._predicted[plan.key] = prediction(spot, self._spot, plan, *fed)
        # Where starts are drawn another histogram has the bounds; a requirement has the rollouts of the whole.
        by_itself = plan.candidates is None or plan.requirement is not None
        unit = robustness_unit(header.config, header.spec)
        found = None if by_itself else self._values.histogram(plan.name, header.config.clip, unit)
        return replace(charts, prediction=self._predicted.get(plan.key), rollouts=found)
