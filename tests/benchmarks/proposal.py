"""CPU milliseconds of one proposal and one observation (ask + tell) of method `paper`, on one BLAS thread."""

import json
import statistics
import sys
import time

import numpy as np
from threadpoolctl import threadpool_limits

from orchestrator.bounds.paper import PaperMethod, Regulariser
from orchestrator.gp.kernels import Matern
from orchestrator.gp.lattice import Lattice

SIZES = (50, 100, 200, 400, 600)
REPEATS = 9


def main() -> dict[str, float]:
    """Return the median CPU ms per ask + tell, keyed `<resolution>/<regulariser>/<n>`."""
    with threadpool_limits(1):
        return {
            f"{resolution}/{regulariser}/{n}": milliseconds
            for resolution in (21, 51)
            for regulariser in ("1+eta", 1.0)
            for n, milliseconds in _measure(resolution, regulariser).items()
        }


def _measure(resolution: int, regulariser: Regulariser) -> dict[int, float]:
    lattice = Lattice((0.0, 0.0), (5.0, 5.0), resolution)
    method = PaperMethod(
        lattice,
        Matern(nu=10, length_scale=1.0),
        rkhs_norm=0.25,
        noise_scale=0.005,
        delta=0.05,
        alpha=1e-9,
        c=0.01,
        regulariser=regulariser,
    )
    rng = np.random.default_rng(0)
    return {n: _ask_and_tell_at(method, n, lattice, rng) for n in SIZES}


def _ask_and_tell_at(method: PaperMethod, n: int, lattice: Lattice, rng: np.random.Generator) -> float:
    while method.n < n:  # filled at random: the cost does not depend on where the points are
        method.observe(int(rng.integers(lattice.size)), float(rng.normal()))
    times = []
    for _ in range(REPEATS):
        start = time.process_time_ns()
        method.observe(method.propose().index, 0.1)
        times.append((time.process_time_ns() - start) / 1e6)
    return round(statistics.median(times), 3)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(), indent=2) + "\n")
