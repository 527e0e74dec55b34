"""CPU microseconds of one rollout in calls of 1,024 tests, and of one test after the other, by method and quantity."""

import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.bounds.method import Integers, Method
from perfbound.orchestrator.mathematics.bounds.sample import SampleMethod, Terms
from perfbound.orchestrator.mathematics.bounds.scenario import Risk, ScenarioMethod
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import SampledQuantity
from tests.fakes.observations import an_observation
from tests.studies.benchmarks.report import Row

BLOCK = 1024
CLIP = (-1.0, 1.0)
SPANS = ((1_000, 1_000 + BLOCK), (100_000, 100_000 + 12 * BLOCK))
"""Of the numbers of tests that are measured; in the second one all values are read anew twice."""
TESTS = SPANS[-1][1]
ALONE = 200
"""Tests that are observed one after the other, before the first span."""
QUANTITIES: dict[SampledQuantity, float] = {
    "failure_probability": 1.0,
    "quantile": 1.0,
    "next_rollout": 0.1,
    "cvar": 10.0,
    "share_of_starts": 10.0,
    "mean": 15.0,
    "risk": 15.0,
}
"""With the most us of a rollout in the second span; on an idle machine it takes about half of it."""
LEVELS: dict[SampledQuantity, float] = {"quantile": 0.1, "cvar": 0.1, "share_of_starts": 0.1, "next_rollout": 0.05}
RISKS: dict[Risk, float] = {"linearised": 10.0, "predictable": 25.0, "bhatia-davis": 10.0, "mean": 10.0}
KRIGING_TESTS = 3 * BLOCK


def main() -> list[Row]:
    """Return the rows."""
    rows = [row for quantity, most in QUANTITIES.items() for row in _sample(quantity, most)]
    rows += [row for risk, most in RISKS.items() for row in _scenario(risk, most)]
    return rows + [row for replicates in (1, 64) for row in _kriging(replicates)]


def _sample(quantity: SampledQuantity, most: float) -> Iterator[Row]:
    terms = Terms(quantity, 0.05, level=LEVELS.get(quantity, 1.0), clip=CLIP, risk_weight=0.2)
    nodes, values = np.zeros(TESTS, dtype=np.int64), _drawn(1)

    def method(fixed: int | None) -> SampleMethod:
        return SampleMethod([terms], lambda number: (float(number),), fixed=fixed, largest=False)

    yield from _measured(f"sample, {quantity}", method(None), nodes, values, most)
    whole = method(TESTS)
    whole.recall_each(nodes, values[:, 0], values)
    yield Row(f"sample, {quantity}: exact bound of {TESTS}", 1e3 * _seconds(whole.bound), "ms")


def _drawn(seed: int) -> Floats:
    return np.clip(np.random.default_rng(seed).normal(0.4, 0.25, TESTS), *CLIP)[:, None]


def _scenario(risk: Risk, most: float) -> Iterator[Row]:
    constants = (0.4, 0.25) if risk == "linearised" else None
    method = ScenarioMethod(
        Points(((0.0,),)), clip=CLIP, risk_weight=0.2, delta=0.05, alpha=0.02, risk=risk, constants=constants
    )
    yield from _measured(f"scenario, {risk}", method, np.zeros(TESTS, dtype=np.int64), _drawn(2), most)


def _kriging(replicates: int) -> Iterator[Row]:
    method = KrigingMethod(
        Lattice((0.0, 0.0), (1.0, 1.0), 51),
        Matern(2.5, 2.0),
        KrigingPremises(0.3, -0.6, (-1.0, 0.0), 0.05),
        spread=0.1,
        budget=KrigingBudget(KRIGING_TESTS, replicates, points=5),
    )
    nodes = np.array([method.design.nodes[point] for point in method.design.order])
    noise = np.random.default_rng(3).standard_normal((len(nodes), replicates))
    values = np.clip(-0.6 + 0.05 * noise, -1.0, 0.0)
    yield from _measured(f"kriging, 2601 nodes, {replicates} a test", method, nodes, values, 0.0)


def _measured(name: str, method: Method, nodes: Integers, values: Floats, most: float) -> Iterator[Row]:
    y, width = -values.mean(axis=1), values.shape[1]

    def blocks(begin: int, end: int) -> None:
        for first in range(begin, end, BLOCK):
            part = slice(first, min(first + BLOCK, end))
            method.observe_each(nodes[part], y[part], values[part])

    begin = SPANS[0][0] - ALONE
    blocks(0, begin)
    tests = [an_observation(*test) for test in zip(nodes[begin:].tolist(), values[begin:].tolist(), strict=True)]
    spent = _seconds(lambda: [method.observe(*test) for test in tests[:ALONE]])
    yield Row(f"{name}, n = {SPANS[0][0]}: one by one", 1e6 * spent / ALONE / width, "us")
    done = SPANS[0][0]
    for span in [span for span in SPANS if span[1] <= len(nodes)]:
        blocks(done, span[0])
        spent, done = _seconds(partial(blocks, *span)), span[1]
        target = most if span == SPANS[-1] else None
        rollouts = (span[1] - span[0]) * width
        yield Row(f"{name}, n = {span[0]}: {BLOCK} at once", 1e6 * spent / rollouts, "us", at_most=target)


def _seconds(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
