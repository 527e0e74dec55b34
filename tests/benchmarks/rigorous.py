"""CPU milliseconds of one proposal, one observation and the bound (ask + tell + bound) of method `rigorous`."""

import json
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from orchestrator.bounds.confidence import mixture
from orchestrator.bounds.rigorous import RigorousMethod
from orchestrator.gp.kernels import Matern
from orchestrator.gp.lattice import Lattice

SIZES = (50, 200, 400, 1000)
REPEATS = 5


def main() -> dict[str, float]:
    """Return the median CPU ms, keyed `<resolution>/<kind of campaign>/<n>`.

    `ucb` observes what the method proposes, as a campaign does: points repeat and are merged. `spread` observes new
    places as long as there are any, the most expensive data there can be.
    """
    with threadpool_limits(1):
        return {
            f"{resolution}/{kind}/{n}": milliseconds
            for resolution in (21, 51)
            for kind in ("ucb", "spread")
            for n, milliseconds in _measure(resolution, kind).items()
        }


def _measure(resolution: int, kind: str) -> dict[int, float]:
    lattice = Lattice((0.0, 0.0), (5.0, 5.0), resolution)
    values = np.sin(lattice.nodes[:, 0]) * np.cos(lattice.nodes[:, 1]) / 2
    rng = np.random.default_rng(0)
    order = np.resize(rng.permutation(lattice.size), 2 * max(SIZES)).tolist()
    method = RigorousMethod(
        lattice,
        Matern(nu=10, length_scale=1.0),
        rkhs_norm=1.5,
        noise_scale=0.005,
        delta=0.05,
        alpha=1e-3,
        regularisers=mixture(1.5, 0.005),
    )

    def step() -> None:
        index = method.propose(None if method.n else 0).index
        index = index if kind == "ucb" else order[method.n]
        method.observe(index, float(values[index] + rng.normal(0, 0.005)))
        method.bound()

    return {n: _at(method, n, step, lambda: _fill(method, n, order, values, rng, kind, step)) for n in SIZES}


def _at(method: RigorousMethod, n: int, step: Callable[[], None], fill: Callable[[], None]) -> float:
    fill()
    times = []
    for _ in range(REPEATS):
        start = time.process_time_ns()
        step()
        times.append((time.process_time_ns() - start) / 1e6)
    return round(statistics.median(times), 3)


def _fill(
    method: RigorousMethod,
    n: int,
    order: list[int],
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    rng: np.random.Generator,
    kind: str,
    step: Callable[[], None],
) -> None:
    while method.n < n:
        if kind == "ucb":
            step()
        else:  # straight into the data: the work per observation is what is measured later
            index = order[method.n]
            method._data.append(index, float(values[index] + rng.normal(0, 0.005)))


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(), indent=2) + "\n")
