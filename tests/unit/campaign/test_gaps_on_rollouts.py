"""On real rollouts: robustness gap <= predicate_sup <= L signal_sup, which every composition rests on."""

import pytest

from perfbound.orchestrator.campaign.objectives import clipped, scored, signal_sup
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.predicates import predicate_sup
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.workers.systems.segway import SegwaySystem
from tests.fakes.segway import STILL, errors

STARTS = [(5.0, 0.0), (0.0, 5.0), (4.5, 4.5), (2.5, 2.5)]
SPECIFICATION = "always (abs(phi) <= 0.95)"
WIDER = (
    "always (abs(phi) <= 0.95) and eventually[5,15] ((x - 2.5)^2 + (y - 2.5)^2 <= 9) "
    "and (abs(phidot) <= 20 until[0,15] (x - 2.5)^2 + (y - 2.5)^2 <= 20)"
)


@pytest.mark.parametrize("gains", ["paper", "aggressive"])
def test_the_gaps_are_ordered_on_every_rollout(gains: str) -> None:
    system = SegwaySystem()
    formula, wider = parse_formula(SPECIFICATION), parse_formula(WIDER)
    for number, start in enumerate(STARTS):
        nominal, true = (
            system.rollout(
                start,
                variant=variant,
                seed=number,
                horizon=15.0,
                options={"gains": gains},
                progress=lambda _: None,
                disturbances=errors(number) if variant == "true" else STILL,
            )
            for variant in ("nominal", "true")
        )
        columns, phi = true.columns, true.columns.index("phi")
        gap = abs(robustness(formula, columns, nominal.samples) - robustness(formula, columns, true.samples))
        values = [clipped(scored(formula, each, None).robustness, (-0.05, 0.75)) for each in (nominal, true)]
        predicates = predicate_sup(formula, columns, true.samples, nominal.samples)
        assert abs(values[0] - values[1]) <= gap <= predicates <= signal_sup(phi, true.samples, nominal.samples)
        assert predicates > 0
        wide = abs(robustness(wider, columns, nominal.samples) - robustness(wider, columns, true.samples))
        assert wide <= predicate_sup(wider, columns, true.samples, nominal.samples)
