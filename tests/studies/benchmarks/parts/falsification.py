"""Simulations to the first counterexample on five systems: ours beside Optuna TPE, random, CMA-ES, dual annealing.

Every search gets the same systems, seeds and budget, asks for one start at a time and ends with the first robustness
below 0. The searches are those of the study `falsification`, the peers in a process of their own environment.

python -m tests.studies.benchmarks.parts.falsification [SYSTEM ...] prints the table of one run with every peer.
"""

import sys
from collections.abc import Sequence

import numpy as np

from tests.studies.benchmarks.parts.failing_systems import SYSTEMS, FailingSystem, share
from tests.studies.benchmarks.report import Row
from tests.studies.falsification.searches import Begin, Ours, outcome, peer_process

SEEDS = range(20)
BUDGET = 1000
"""Simulations after which a search counts as having taken `BUDGET`."""
RESAMPLES = 10_000
LEVEL = 0.9


def simulations(begin: Begin, system: FailingSystem, seeds: Sequence[int] = SEEDS) -> list[int]:
    """Return the simulations to the first counterexample for each seed, at most `BUDGET`."""
    found = (outcome(begin(system.dimension, seed), lambda unit: (system(unit), ()), BUDGET) for seed in seeds)
    return [each.simulations for each in found]


def interval(counts: Sequence[int]) -> tuple[float, float]:
    """Return the bootstrap interval of the median.

    >>> interval([5] * 20)
    (5.0, 5.0)
    """
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(np.array(counts), (RESAMPLES, len(counts))), axis=1)
    low, high = np.quantile(medians, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


NAMES = ("random", "Optuna TPE", "Optuna TPE, multivariate", "CMA-ES", "dual annealing")


def main(*, alone: bool = False, systems: Sequence[FailingSystem] = SYSTEMS) -> list[Row]:
    """Return the rows of every system: its share of failures, our median beside the best peer's, and the peers'."""
    if alone:
        return [row for system in systems for row in _rows(system, {})]
    with peer_process() as peers:
        searches = {name: peers.begin(name) for name in NAMES}
        return [row for system in systems for row in _rows(system, searches)]


def _rows(system: FailingSystem, peers: dict[str, Begin]) -> list[Row]:
    counts = {name: simulations(search, system) for name, search in peers.items()}
    medians = {name: float(np.median(each)) for name, each in counts.items()}
    mine = simulations(Ours, system)
    name = f"falsification, {system.name} ({system.dimension} parameters)"
    best = min(medians, key=medians.__getitem__, default=None)
    # At most the best peer's, within the bootstrap interval of the peer's median.
    goal = None if best is None else interval(counts[best])[1]
    rows = [
        Row(f"{name}: failing starts", 100 * share(system), "%"),
        Row(
            f"{name}: first counterexample {_spread(mine)}",
            float(np.median(mine)),
            "simulations",
            best or "",
            None if best is None else medians[best],
            at_most=goal,
        ),
    ]
    return rows + [
        Row(f"{name}: peer {peer} {_spread(each)}", medians[peer], "simulations") for peer, each in counts.items()
    ]


def _spread(counts: Sequence[int]) -> str:
    low, high = interval(counts)
    failed = sum(count >= BUDGET for count in counts)
    return f"[{low:g}, {high:g}]" + (f", {failed} of {len(counts)} without" if failed else "")


if __name__ == "__main__":
    from tests.studies.benchmarks.report import table

    chosen = [system for system in SYSTEMS if system.name in (sys.argv[1:] or [each.name for each in SYSTEMS])]
    sys.stdout.write(table(main(systems=chosen)))
