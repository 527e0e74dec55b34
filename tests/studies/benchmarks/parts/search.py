"""CPU milliseconds of a test of a search over 40 parameters, without its simulation: a proposal and an observation.

The function is smooth and nowhere below 0, so that no test ends the search. The length scales are fitted once while the
tests grow by a tenth: a mean over a tenth more tests contains one fit.
"""

import time
from collections.abc import Iterator

import numpy as np

from perfbound.orchestrator.mathematics.search import Falsifier
from perfbound.orchestrator.mathematics.search.goal import ALONE, Every, Goal, Part, margins
from tests.studies.benchmarks.report import Row

DIMENSION = 40
WANTED = {300: 20.0, 2000: 60.0}
"""Tests before those that are measured, with the most ms of one."""
PARTS = 3
"""Of a conjunction, which has a model of each part and one of the whole."""
FEWEST = min(WANTED)


def main() -> list[Row]:
    """Return the rows."""
    goal = Every(tuple(map(Part, range(PARTS))))
    return [*_measured("one part", ALONE, WANTED), *_measured(f"{PARTS} parts", goal, {FEWEST: None})]


def values(x: np.ndarray, parts: int) -> np.ndarray:
    """Return the robustness (k,) of each part at a point (p,) of the unit box: bowls with a floor of 0.1.

    >>> values(np.full(40, 0.2), 2).round(6).tolist()
    [0.1, 3.7]
    """
    places = np.linspace(0.2, 0.8, max(parts, 1))[:parts, None]
    weights = 1.0 / (1.0 + np.arange(x.size))
    return np.asarray(0.1 + 10 * ((x - places) ** 2) @ (weights / weights.sum()))


def _measured(name: str, goal: Goal, wanted: dict[int, float] | dict[int, None]) -> Iterator[Row]:
    search = Falsifier((0.0,) * DIMENSION, (1.0,) * DIMENSION, seed=1, goal=goal)
    parts = 1 if goal == ALONE else PARTS
    spent = [0.0]
    for size, most in wanted.items():
        while len(spent) <= size + size // 10:
            spent.append(spent[-1] + _seconds(search, goal, parts))
        mean = (spent[-1] - spent[size]) / (size // 10)
        yield Row(f"search, {DIMENSION} parameters, {name}: after {size} tests", 1e3 * mean, "ms", at_most=most)
    yield Row(f"search, {DIMENSION} parameters, {name}: {len(spent) - 1} tests", spent[-1], "s")


def _seconds(search: Falsifier, goal: Goal, parts: int) -> float:
    """Return the CPU time of the next test."""
    begin = time.process_time()
    point = search.propose()
    spent = time.process_time() - begin
    each = values(np.array(point), parts)
    value = float(margins(goal, each[None, :])[0])
    begin = time.process_time()
    search.observe(point, value, each.tolist() if parts > 1 else ())
    return spent + time.process_time() - begin
