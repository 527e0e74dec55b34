"""Simulations to the first counterexample on five systems: ours beside Optuna TPE, random, CMA-ES, dual annealing.

Every search gets the same systems, seeds and budget, asks for one start at a time and ends with the first robustness
below 0. The peers run in a process of their own environment (`falsification_peers.py`).

python -m tests.studies.benchmarks.parts.falsification [SYSTEM ...] prints the table of one run with every peer.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from tests.studies.benchmarks.parts.failing_systems import SYSTEMS, FailingSystem, share
from tests.studies.benchmarks.report import Row

SEEDS = range(20)
BUDGET = 1000
"""Simulations after which a search counts as having taken `BUDGET`."""
RESAMPLES = 10_000
LEVEL = 0.9
PEERS = Path(".venv-bench/bin/python")

Floats = NDArray[np.float64]
Objective = Callable[[Floats], float]
Search = Callable[[Objective, int, int], None]
"""(objective, number of parameters, seed): asks for points of the unit box until the objective raises."""


class EndError(Exception):
    """The first counterexample, or the end of the budget."""


@dataclass
class Counter:
    """An objective that counts its calls and ends the search with the first value below 0."""

    objective: Objective
    calls: int = 0

    def __call__(self, point: Floats) -> float:
        """Return the value at a point (p,)."""
        self.calls += 1
        value = self.objective(point)
        if value < 0 or self.calls >= BUDGET:
            raise EndError
        return value


def simulations(search: Search, system: FailingSystem, seeds: Sequence[int] = SEEDS) -> list[int]:
    """Return the simulations to the first counterexample for each seed, at most `BUDGET`."""
    found = []
    for seed in seeds:
        counter = Counter(system)
        try:
            search(counter, system.dimension, seed)
        except EndError:
            found.append(counter.calls)
    return found


def ours(objective: Objective, dimension: int, seed: int) -> None:
    """Our search."""
    from perfbound.orchestrator.mathematics.search import Falsifier

    search = Falsifier((0.0,) * dimension, (1.0,) * dimension, seed=seed)
    while True:
        point = search.propose()
        search.observe(point, objective(np.array(point)))


def interval(counts: Sequence[int]) -> tuple[float, float]:
    """Return the bootstrap interval of the median.

    >>> interval([5] * 20)
    (5.0, 5.0)
    """
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(np.array(counts), (RESAMPLES, len(counts))), axis=1)
    low, high = np.quantile(medians, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


class PeerProcess:
    """The process of the peers, which asks for values by lines."""

    def __init__(self, stdin: IO[str], stdout: IO[str]) -> None:
        self._in, self._out = stdin, stdout
        self.versions: dict[str, str] = json.loads(stdout.readline())

    def search(self, peer: str) -> Search:
        """Return a peer as a search."""

        def run(objective: Objective, dimension: int, seed: int) -> None:
            self._write(json.dumps({"peer": peer, "dimension": dimension, "seed": seed}))
            try:
                while True:
                    self._write(repr(objective(np.array(json.loads(self._out.readline())))))
            except EndError:
                self._write("")
                raise

        return run

    def _write(self, line: str) -> None:
        self._in.write(line + "\n")
        self._in.flush()


@contextmanager
def peer_process() -> Iterator[PeerProcess]:
    """Start the process of the peers, and end it."""
    command = [str(PEERS), "-m", "tests.studies.benchmarks.parts.falsification_peers"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield PeerProcess(process.stdin, process.stdout)
        process.stdin.close()


NAMES = ("random", "Optuna TPE", "Optuna TPE, multivariate", "CMA-ES", "dual annealing")


def main(*, alone: bool = False, systems: Sequence[FailingSystem] = SYSTEMS) -> list[Row]:
    """Return the rows of every system: its share of failures, our median beside the best peer's, and the peers'."""
    if alone:
        return [row for system in systems for row in _rows(system, {})]
    with peer_process() as peers:
        searches = {name: peers.search(name) for name in NAMES}
        return [row for system in systems for row in _rows(system, searches)]


def _rows(system: FailingSystem, peers: dict[str, Search]) -> list[Row]:
    counts = {name: simulations(search, system) for name, search in peers.items()}
    medians = {name: float(np.median(each)) for name, each in counts.items()}
    mine = simulations(ours, system)
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
