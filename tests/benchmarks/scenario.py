"""CPU microseconds per observed value and milliseconds per propose + bound of method `scenario`, by rollouts so far."""

import json
import statistics
import sys
import time

import numpy as np

from orchestrator.bounds.scenario import Risk, ScenarioMethod

MARKS = (250, 1000, 6000)
BATCH = 10
REPEATS = 21


def main() -> dict[str, float]:
    """Return the numbers keyed `<scenarios>/<risk>/<rollouts>/<us per value | ms per ask>`."""
    found: dict[str, float] = {}
    for size in (25, 400):
        for risk in ("linearised", "bhatia-davis"):
            found |= {f"{size}/{risk}/{key}": value for key, value in _measure(size, risk).items()}
    return found


def _measure(size: int, risk: Risk) -> dict[str, float]:
    method = ScenarioMethod(
        np.arange(size, dtype=np.float64)[:, None],
        clip=(-0.05, 0.75),
        risk_weight=0.2,
        delta=0.05,
        alpha=1e-6,
        risk=risk,
        constants=(0.7, 0.09) if risk == "linearised" else None,
    )
    rng, found = np.random.default_rng(0), {}
    spent, rollouts = 0, 0
    for mark in MARKS:
        start_at = rollouts
        while rollouts < mark:
            values = np.clip(rng.normal(0.7, 0.08, BATCH), -0.05, 0.75).tolist()
            index = method.propose()
            start = time.process_time_ns()
            method.observe(index, values)
            spent += time.process_time_ns() - start
            rollouts += BATCH
        found[f"{mark}/us per value"] = round(spent / 1e3 / (rollouts - start_at), 1)
        found[f"{mark}/ms per ask"] = _ask(method)
        spent = 0
    return found


def _ask(method: ScenarioMethod) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.process_time_ns()
        method.propose(pending=(0, 1, 1))
        method.bound()
        times.append((time.process_time_ns() - start) / 1e6)
    return round(statistics.median(times), 4)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(), indent=2) + "\n")
