"""Campaigns whose disturbance has another scale than is declared: how often that makes a bound wrong, and is seen."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import ndtr

from perfbound.orchestrator.mathematics.bounds.checks.law import LawTest
from perfbound.orchestrator.mathematics.bounds.checks.stationarity import LEVEL
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingMethod
from perfbound.orchestrator.mathematics.control.sequence import Disturbed as Known
from tests.studies.coverage.controls.campaigns import BASES, REPLICATES, Bounds, Controls, aim_of, bounds_of, method_of
from tests.studies.coverage.controls.disturbed import Disturbed, Floats, draw, of_scale
from tests.studies.coverage.oracle import ROUNDING

BOUNDS: tuple[Bounds, ...] = ("kriging", "mean")
SCALES = (1.0, 0.9, 1.1)
ROLLOUTS = (512, 1024, 2048, 4096)


@dataclass(frozen=True)
class DeclaredLaw(Controls):
    """One row: the disturbance, which is reported, explains everything, and the bound is that of the last rollout."""

    kind: ClassVar[str] = "law-audit"
    disturbances: str = "a fall"
    law_scale: float = 1.0
    rollouts: int = ROLLOUTS[0]
    levels: ClassVar[dict[str, float]] = {"law": LEVEL}
    """Probability of a statement that is not the claimed one."""

    @property
    def tests(self) -> int:
        """Number of tests, of REPLICATES rollouts each."""
        return self.rollouts // REPLICATES

    @property
    def law(self) -> Disturbed:
        """The rollouts."""
        return of_scale(self.law_scale)


def rows() -> Iterator[DeclaredLaw]:
    """Both kinds of bounds, the right law and two wrong ones."""
    for bounds in BOUNDS:
        for scale in SCALES:
            for rollouts in ROLLOUTS:
                yield DeclaredLaw(bounds, law_scale=scale, rollouts=rollouts)


def campaign(row: DeclaredLaw, rng: np.random.Generator) -> dict[str, float]:
    """Run one campaign: `law`, whether the law was refuted, `norm`, whether B was, and whether the bound is wrong."""
    scores = list[Floats]()
    width = REPLICATES if row.bounds == "kriging" else 1
    method = method_of(row, row.delta, Known(BASES, lambda test, _: scores[test], row.rollouts))
    declared, norm, law = LawTest(1), False, row.law
    for test in range(row.tests):
        drawn = draw(rng, REPLICATES, row.law_scale)
        declared.observe(ndtr(drawn[:, :1]))
        scores.extend(drawn.reshape(-1, width, 2))
        each = law.value(drawn, rng, 1).reshape(-1, width)
        nodes = np.zeros(len(each), dtype=np.int64)
        if not isinstance(method, KrigingMethod):
            method.recall_each(nodes, np.zeros(len(each)), each)
            continue
        nodes += method.design.nodes[method.design.order[test]]
        norm = method.observe_each(nodes, np.zeros(1), -each).verdict == "refuted"
        if norm:  # it ends the campaign
            break
    bound, _ = bounds_of(method)
    refuted, wrong = declared.finding().status == "refuted", bound > aim_of(row) + ROUNDING
    return {
        "law": refuted,
        "norm": norm,
        "bound": wrong,
        "unnoticed": wrong and not refuted and not norm,
        "width": aim_of(row) - bound,
    }
