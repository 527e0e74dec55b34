"""The charts of one problem, from its own facts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...schemas.file.config import CampaignConfig
from ...schemas.values import Bound
from ..campaign.methods import ProblemMethod
from ..campaign.plan import ProblemPlan
from ..mathematics.bounds.sample import SampleMethod
from ..store.read import ObservedTest
from . import importance, limits
from .chart_data import ProblemCharts


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
