"""CPU times of method `kriging` on 41 x 41 nodes with 25 points: its plan, and tests of 1 and of 16 rollouts."""

import time

import numpy as np

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.schemas.values import Observation
from tests.studies.benchmarks.report import Row

BOX = Lattice((0.0, 0.0), (5.0, 5.0), 41)
PREMISES = KrigingPremises(0.2, -0.66, (-0.74, 0.53), 0.05)
ROLLOUTS = 6400


def main() -> list[Row]:
    """Return the rows."""
    return [row for replicates in (1, 16) for row in _measure(replicates)]


def _measure(replicates: int) -> list[Row]:
    name, tests = f"kriging, 1681 nodes, 25 points, {replicates} rollouts a test", ROLLOUTS // replicates
    start = time.process_time()
    method = KrigingMethod(
        BOX, Matern(2.5, 3.0), PREMISES, spread=0.1, budget=KrigingBudget(tests, replicates, points=5)
    )
    planned = time.process_time() - start
    values = np.clip(0.68 + 0.1 * np.random.default_rng(0).standard_normal((tests, replicates)), -0.5, 0.7)
    start = time.process_time()
    for each in -values:
        method.observe(method.propose(), Observation(float(each.mean()), tuple(each.tolist())))
    spent = time.process_time() - start
    return [
        Row(f"{name}: design and weights", planned, "s", at_most=10.0),
        Row(f"{name}: per rollout", 1e3 * spent / ROLLOUTS, "ms", at_most=1.0),
        Row(f"{name}: all bounds of {ROLLOUTS} rollouts", spent, "s", at_most=6.0),
    ]
