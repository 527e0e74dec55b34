"""Throughput of the same campaign with one local worker and with two."""

import os
import sys

from tests.studies.benchmarks.parts.rollout import bare_steps
from tests.studies.benchmarks.report import Row
from tests.studies.benchmarks.runs import Cost, conduct

TESTS = 50
"""Of 8 rollouts each."""
REPEATS = 2
EFFICIENCY = 0.9
QUIET = 0.5
"""Load of others up to which wall times mean something."""


def main() -> list[Row]:
    """Measure without and with the visual part of the files."""
    load, bare = os.getloadavg()[0], bare_steps()
    if load > QUIET:
        sys.stderr.write(f"  the machine is loaded ({load:.1f}): wall times are no measurement of two workers\n")
    rows = [row for visual in ("none", "all") for row in _pair(visual, bare)]
    return [Row(f"load before the throughput, which wants at most {QUIET}", load, "processes"), *rows]


def _pair(visual: str, bare: float) -> list[Row]:
    """Wall times, so the better of two runs counts.

    A worker takes c_w of CPU time a rollout, the orchestrator c_o, and it works while workers work. On two cores one
    worker then brings 1/c_w rollouts a second, and two bring 2/(c_w + c_o).
    """
    one, two = _best(1, visual), _best(2, visual)
    label = f'segway-scenario, visual = "{visual}"'
    c_w, c_o = one.simulating / one.rollouts, one.loop / one.rollouts
    ideal = 2 / (1 + c_o / c_w)
    times = _throughput(two) / _throughput(one)
    bare_rate = "bare engine, a core-second", 1 / bare
    return [
        Row(f"{label}: worker, per rollout", 1000 * c_w, "ms"),
        Row(f"{label}: in a worker process, per core-second", 1 / c_w, "rollouts/s", *bare_rate),
        Row(f"{label}: orchestrator's loop, per rollout", 1000 * c_o, "ms"),
        Row(f"{label}: throughput of 1 worker", _throughput(one), "rollouts/s"),
        Row(f"{label}: throughput of 2 workers", _throughput(two), "rollouts/s"),
        Row(f"{label}: 2 workers against 1", times, "times", "2/(1 + c_o/c_w)", ideal, ratio_at_least=EFFICIENCY),
    ]


def _throughput(cost: Cost) -> float:
    return cost.rollouts / cost.wall


def _best(workers: int, visual: str) -> Cost:
    costs = []
    for _ in range(REPEATS):
        before = os.getloadavg()[0]
        changes = {"visual": f'"{visual}"', "max_tests": str(TESTS), "alpha": "1e-9"}
        costs.append(conduct("segway-scenario", changes, workers=workers))
        load = f"load {before:.1f} before"
        sys.stderr.write(f'  visual = "{visual}", {workers} workers: {_throughput(costs[-1]):.1f} rollouts/s, {load}\n')
    return max(costs, key=_throughput)
