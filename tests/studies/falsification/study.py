"""Searches on benchmarks: simulations to the first counterexample, one row for each benchmark, search and seed."""

import json
import multiprocessing
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.mathematics.search.goal import goal_of
from perfbound.orchestrator.mathematics.stl.parser import Formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.schemas import atomic
from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.registry import benchmark, benchmarks
from tests.studies.falsification.searches import Begin, Objective, Ours, PeerProcess, outcome, peer_process

RESULTS = Path(__file__).with_name("results.json")
PROCESSES = 2
OURS = "perfbound"
SEARCHES = (
    OURS,
    "random",
    "dual annealing",
    "CMA-ES",
    "Optuna TPE, multivariate",
    "Optuna CMA-ES",
    "TuRBO-1",
    "psy-taliro, dual annealing",
)
"""Those of the page; uniform random of psy-taliro has the law of `random`."""
FINAL = range(20)
"""Seeds of the final measurement; a search under development is measured with others, from 1000 on."""
BUDGET = 300


@dataclass(frozen=True, order=True)
class Run:
    """A search to be run; two of one run are equal."""

    benchmark: str
    instance: int
    search: str
    seed: int
    budget: int


@dataclass(frozen=True)
class Row:
    """A search that was run."""

    run: Run
    simulations: int
    found: bool
    cpu_ms: float
    """CPU time of the search itself per simulation."""


def simulated(system: Benchmark, point: Floats) -> Rollout:
    """Return the rollout at a point (p,) of the unit box."""
    low, high = np.array(system.low), np.array(system.high)
    return system.simulate(low + np.clip(point, 0.0, 1.0) * (high - low))


def value(formula: Formula, rollout: Rollout) -> float:
    """Return the robustness of a rollout."""
    times, columns = rollout
    return robustness(formula, ("t", *columns), np.column_stack([times, *columns.values()]))


def objective_of(system: Benchmark) -> Objective:
    """Return the robustness, and that of each part of the requirement, as a function on the unit box."""
    _, parts = goal_of(system.parsed)
    parts = parts if len(parts) > 1 else ()

    def margins(point: Floats) -> tuple[float, tuple[float, ...]]:
        rollout = simulated(system, point)
        return value(system.parsed, rollout), tuple(value(part, rollout) for part in parts)

    return margins


def runs(
    names: Sequence[str], instances: Sequence[int], searches: Sequence[str], seeds: Iterable[int], budget: int
) -> list[Run]:
    """Return the runs of these benchmarks, all if `names` is empty; of a seed come all before the next one."""
    chosen = [each for each in benchmarks() if each.instance in instances and (not names or each.name in names)]
    return [
        Run(each.name, each.instance, search, seed, budget) for seed in seeds for each in chosen for search in searches
    ]


_AT_EXIT = ExitStack()


@cache
def _peers() -> PeerProcess:
    """Return the process of the peers that belongs to this one."""
    return _AT_EXIT.enter_context(peer_process())


def begin_of(search: str, system: Benchmark) -> Begin:
    """Return how a search of this name begins; ours knows the parts of the requirement and the inputs over time."""
    if search == OURS:
        return partial(Ours, goal=goal_of(system.parsed)[0], signals=system.signals)
    return _peers().begin(search)


def measured(run: Run) -> Row:
    """Run a search."""
    system = benchmark(run.benchmark, run.instance)
    with threadpool_limits(1):
        found = outcome(begin_of(run.search, system)(system.dimension, run.seed), objective_of(system), run.budget)
    return Row(run, found.simulations, found.found, round(1000 * found.cpu / found.simulations, 2))


def measure(wanted: Sequence[Run], results: Path, processes: int = PROCESSES) -> Iterator[Row]:
    """Run what the file of results has not, and put each row into it at once."""
    rows = {row.run: row for row in read(results)}
    missing = [run for run in dict.fromkeys(wanted) if run not in rows]
    # Processes of their own begin without the threads and pipes of this one.
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"))
    try:
        for done in as_completed([pool.submit(measured, run) for run in missing]):
            row = done.result()
            rows[row.run] = row
            write(rows.values(), results)
            yield row
    finally:
        pool.shutdown(cancel_futures=True)


def read(results: Path) -> list[Row]:
    """Return the rows of a file, none if there is no file."""
    if not results.exists():
        return []
    keys = ("benchmark", "instance", "search", "seed", "budget")
    return [
        Row(Run(*(line[key] for key in keys)), line["simulations"], line["found"], line["cpu_ms"])
        for line in json.loads(results.read_text(encoding="utf-8"))
    ]


def text(rows: Iterable[Row]) -> str:
    """Return the text of a file of results: a line for each row."""
    lines = ({**asdict(row.run), **asdict(row), "run": None} for row in sorted(rows, key=lambda row: row.run))
    listed = (json.dumps({key: each for key, each in line.items() if key != "run"}) for line in lines)
    return "[\n" + ",\n".join(listed) + "\n]\n"


def write(rows: Iterable[Row], results: Path) -> None:
    """Write a file of results whole."""
    atomic.write_whole(results, text(rows).encode())
