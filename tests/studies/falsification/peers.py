"""The searches that a user would take instead, by question and answer: a point in the unit box out, its value in.

Run in an environment of its own, which has no perfbound: `.venv-bench/bin/python -m tests.studies.falsification.peers`.
A line on stdin names a peer, the number of parameters and a seed; then every line out is the CPU time in s that the
peer has used since its first point, and a point (JSON), and every line in its value, until the line is empty. What the
libraries print goes to stderr.
"""

import json
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from importlib.metadata import version
from typing import Any

import numpy as np

Objective = Callable[[Any], float]
"""(a point of the unit box, shape (p,)) -> its value; raises `EndError` once the search is over."""
STEP = 0.3
"""First step of CMA-ES in shares of a range: the author's advice is about a third of it."""


class EndError(Exception):
    """The search is over."""


def optuna_tpe(objective: Objective, dimension: int, seed: int, *, multivariate: bool = False) -> None:
    """Tree-structured Parzen estimator of Optuna, as it comes or with joint densities."""
    import optuna  # type: ignore[import-not-found]

    _ask_and_tell(objective, dimension, optuna.samplers.TPESampler(seed=seed, multivariate=multivariate))


def _ask_and_tell(objective: Objective, dimension: int, sampler: Any) -> None:
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=sampler)
    names = [f"z{axis}" for axis in range(dimension)]
    while True:
        trial = study.ask({name: optuna.distributions.FloatDistribution(0.0, 1.0) for name in names})
        study.tell(trial, objective([trial.params[name] for name in names]))


def optuna_tpe_multivariate(objective: Objective, dimension: int, seed: int) -> None:
    """Tree-structured Parzen estimator of Optuna with joint densities."""
    optuna_tpe(objective, dimension, seed, multivariate=True)


def optuna_cma_es(objective: Objective, dimension: int, seed: int) -> None:
    """CMA-ES of Optuna, as it comes: its first start is the middle, and it does not begin again."""
    import optuna

    _ask_and_tell(objective, dimension, optuna.samplers.CmaEsSampler(seed=seed))


def random(objective: Objective, dimension: int, seed: int) -> None:
    """Independent uniform starts."""
    rng = np.random.default_rng(seed)
    while True:
        objective(rng.random(dimension))


def cma_es(objective: Objective, dimension: int, seed: int) -> None:
    """CMA-ES of its author, from a random point and again with a doubled population when it has converged."""
    import cma  # type: ignore[import-not-found]

    rng, population = np.random.default_rng(seed), 4 + int(3 * np.log(dimension))
    while True:
        options = {"bounds": [0, 1], "seed": int(rng.integers(1, 2**31)), "popsize": population, "verbose": -9}
        search = cma.CMAEvolutionStrategy(rng.random(dimension), STEP, options)
        while not search.stop():
            points = search.ask()
            search.tell(points, [objective(point) for point in points])
        population *= 2


def dual_annealing(objective: Objective, dimension: int, seed: int) -> None:
    """Dual annealing of SciPy with its local search, as it comes, and again when it has ended."""
    from scipy.optimize import dual_annealing as minimise

    rng = np.random.default_rng(seed)
    while True:
        minimise(objective, [(0.0, 1.0)] * dimension, rng=rng)


def turbo(objective: Objective, dimension: int, seed: int) -> None:
    """TuRBO-1 on BoTorch."""
    from tests.studies.falsification.turbo import search

    search(objective, dimension, seed)


AT_ONCE = 10_000
"""Samples that an optimiser of psy-taliro may take at most; more than any budget."""


class _Evaluated:
    """What an optimiser of psy-taliro asks for the cost of a sample."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective

    def eval_sample(self, sample: Any) -> float:
        """Return the cost."""
        return self._objective(sample.values)

    def eval_samples(self, samples: Any) -> list[float]:
        """Return the costs, one after the other."""
        return [self.eval_sample(sample) for sample in samples]


def taliro_random(objective: Objective, dimension: int, seed: int) -> None:
    """Uniform random of psy-taliro."""
    from staliro.optimizers import UniformRandom  # type: ignore[import-not-found]

    _taliro(UniformRandom(), objective, dimension, seed)


def taliro_annealing(objective: Objective, dimension: int, seed: int) -> None:
    """Dual annealing of psy-taliro, which has no local search."""
    from staliro.optimizers import DualAnnealing

    _taliro(DualAnnealing(), objective, dimension, seed)


def _taliro(optimiser: Any, objective: Objective, dimension: int, seed: int) -> None:
    from staliro.optimizers import Optimizer
    from staliro.signals import Interval  # type: ignore[import-not-found]

    bounds = [Interval(0.0, 1.0) for _ in range(dimension)]
    for again in range(AT_ONCE):
        parameters = Optimizer.Params(seed=seed + 10_000 * again, budget=AT_ONCE, input_bounds=bounds)
        optimiser.optimize(_Evaluated(objective), parameters)


PEERS: dict[str, Callable[[Objective, int, int], None]] = {
    "random": random,
    "Optuna TPE": optuna_tpe,
    "Optuna TPE, multivariate": optuna_tpe_multivariate,
    "Optuna CMA-ES": optuna_cma_es,
    "CMA-ES": cma_es,
    "dual annealing": dual_annealing,
    "TuRBO-1": turbo,
    "psy-taliro, uniform random": taliro_random,
    "psy-taliro, dual annealing": taliro_annealing,
}
PACKAGES = ("botorch", "cma", "cmaes", "numpy", "optuna", "psy-taliro", "scipy", "torch")


def main() -> None:
    """Answer until stdin ends; the first line out names the versions."""
    answers = sys.stdout
    begin: float | None = None

    def objective(point: Any) -> float:
        nonlocal begin
        now = time.process_time()
        begin = now if begin is None else begin  # after the imports
        used = now - begin
        answers.write(json.dumps([used, [float(value) for value in point]]) + "\n")
        answers.flush()
        line = sys.stdin.readline()
        if not line.strip():
            raise EndError
        return float(line)

    answers.write(json.dumps({name: version(name) for name in PACKAGES}) + "\n")
    answers.flush()
    warnings.simplefilter("ignore")  # of experimental functions, and of fits that are repeated
    with redirect_stdout(sys.stderr):
        for line in iter(sys.stdin.readline, ""):
            asked, begin = json.loads(line), None
            try:
                PEERS[asked["peer"]](objective, asked["dimension"], asked["seed"])
            except EndError:
                continue


if __name__ == "__main__":
    main()
