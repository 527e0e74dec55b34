"""CPU microseconds per observed value and milliseconds per propose + bound of method `scenario`, by rollouts so far."""

import statistics
import time

import numpy as np

from perfbound.orchestrator.mathematics.bounds.scenario import Risk, ScenarioMethod
from perfbound.orchestrator.mathematics.gp.points import Points
from tests.fakes.observations import an_observation
from tests.studies.benchmarks.report import Row

MARKS = (250, 1000, 6000)
BATCH = 10
REPEATS = 21
RISKS: tuple[Risk, ...] = ("linearised", "bhatia-davis")


def main() -> list[Row]:
    """Return the rows by number of starts, kind of risk and rollouts so far."""
    return [row for size in (25, 400) for risk in RISKS for row in _measure(size, risk)]


def _measure(size: int, risk: Risk) -> list[Row]:
    method = ScenarioMethod(
        Points(tuple((float(k),) for k in range(size))),
        clip=(-0.05, 0.75),
        risk_weight=0.2,
        delta=0.05,
        alpha=1e-6,
        risk=risk,
        constants=(0.7, 0.09) if risk == "linearised" else None,
    )
    rng, rows = np.random.default_rng(0), list[Row]()
    spent, rollouts = 0, 0
    for mark in MARKS:
        start_at = rollouts
        while rollouts < mark:
            values = np.clip(rng.normal(0.7, 0.08, BATCH), -0.05, 0.75).tolist()
            index = method.propose().node
            start = time.process_time_ns()
            method.observe(*an_observation(index, values))
            spent += time.process_time_ns() - start
            rollouts += BATCH
        name = f"scenario, {size} starts, {risk}, after {mark} rollouts"
        rows += [
            Row(f"{name}: per value", spent / 1e3 / (rollouts - start_at), "us"),
            Row(f"{name}: propose and bound", _ask(method), "ms"),
        ]
        spent = 0
    return rows


def _ask(method: ScenarioMethod) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.process_time_ns()
        method.propose(pending=(0, 1, 1))
        method.bound()
        times.append((time.process_time_ns() - start) / 1e6)
    return round(statistics.median(times), 4)
