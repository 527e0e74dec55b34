"""CPU milliseconds of one ask + tell of the libraries that a user would take instead; JSON on stdout.

Run in an environment of its own, without perfbound: `.venv-bench/bin/python -m tests.studies.benchmarks.peers`.
Every peer gets the same tests in the same order (`data.py`), one thread, and the settings that are best for it:
hyper-parameters are fixed where the library allows it, so that nothing is fitted.

What was tried for BoTorch: the posterior on the lattice jointly, with `fast_pred_var`, as a batch of single points, and
in chunks, which is several times faster than the first two; a new model per test, and `condition_on_observations`.
"""

import json
import signal
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern
from threadpoolctl import threadpool_limits

from tests.studies.benchmarks import data

LIMIT = 60.0
"""CPU seconds that one ask + tell may take; a peer that needs more is not asked at larger sizes."""
SLOW = 2.0
"""CPU seconds above which one measurement is enough."""
REPEATS = 5
CHUNK = 128
"""Nodes whose posterior BoTorch is asked for at once."""


class Peer(Protocol):
    """A library that has observed some tests."""

    def step(self, node: int, y: float) -> int | None:
        """Add one more observation and request a proposal; return its node, where it is one of the lattice."""
        ...


class TooSlowError(Exception):
    """The limit of CPU time is reached."""


class Scikit:
    """GaussianProcessRegressor, refitted per test with fixed hyper-parameters; the argmax on the lattice."""

    def __init__(self, nodes: list[int], y: list[float]) -> None:
        self._lattice = data.lattice()
        self._nodes, self._y = nodes, y

    def step(self, node: int, y: float) -> int:
        self._nodes.append(node)
        self._y.append(y)
        kernel = Matern(length_scale=data.LENGTH_SCALE, nu=data.NU)
        model = GaussianProcessRegressor(kernel, alpha=data.REGULARISER, optimizer=None)
        model.fit(self._lattice[self._nodes], np.array(self._y))
        mu, sigma = model.predict(self._lattice, return_std=True)
        return int(np.argmax(mu + data.SCALE * sigma))


class Botorch:
    """SingleTaskGP with fixed hyper-parameters, made anew per test or conditioned on it, and UpperConfidenceBound."""

    def __init__(self, nodes: list[int], y: list[float], *, on_lattice: bool, condition: bool) -> None:
        import torch  # type: ignore[import-not-found]

        torch.set_num_threads(1)
        torch.manual_seed(0)
        self._torch: Any = torch
        self._lattice = torch.tensor(data.lattice())
        self._x, self._y = self._lattice[nodes], torch.tensor(y, dtype=torch.double)[:, None]
        self._on_lattice, self._condition = on_lattice, condition
        self._model = self._made()
        self._model.posterior(self._lattice[:1])  # fills the caches that conditioning updates

    def step(self, node: int, y: float) -> int | None:
        x, value = self._lattice[node : node + 1], self._torch.tensor([[y]], dtype=self._torch.double)
        if self._condition:
            noise = self._torch.full_like(value, data.REGULARISER)
            self._model = self._model.condition_on_observations(x, value, noise=noise)
        else:
            self._x, self._y = self._torch.cat([self._x, x]), self._torch.cat([self._y, value])
            self._model = self._made()
        if self._on_lattice:
            return self._on_nodes()
        self._optimise()
        return None

    def _made(self) -> Any:
        from botorch.models import SingleTaskGP  # type: ignore[import-not-found]
        from gpytorch.kernels import MaternKernel  # type: ignore[import-not-found]
        from gpytorch.means import ZeroMean  # type: ignore[import-not-found]

        kernel = MaternKernel(nu=data.NU)
        kernel.lengthscale = data.LENGTH_SCALE
        noise = self._torch.full_like(self._y, data.REGULARISER)
        model = SingleTaskGP(
            self._x, self._y, train_Yvar=noise, covar_module=kernel, mean_module=ZeroMean(), outcome_transform=None
        )
        model.to(self._torch.double).eval()
        return model.requires_grad_(False)

    def _on_nodes(self) -> int:
        with self._torch.no_grad():
            found = [self._model.posterior(chunk) for chunk in self._lattice.split(CHUNK)]
            values = [each.mean + data.SCALE * each.variance.sqrt() for each in found]
        return int(self._torch.cat(values).argmax())

    def _optimise(self) -> None:
        from botorch.acquisition import UpperConfidenceBound  # type: ignore[import-not-found]
        from botorch.optim import optimize_acqf  # type: ignore[import-not-found]

        box = self._torch.tensor([[data.LOW] * 2, [data.HIGH] * 2], dtype=self._torch.double)
        bound = UpperConfidenceBound(self._model, beta=data.SCALE**2)
        optimize_acqf(bound, bounds=box, q=1, num_restarts=4, raw_samples=64)


class Optuna:
    """GPSampler; it fits its hyper-parameters at every ask, which cannot be turned off."""

    def __init__(self, nodes: list[int], y: list[float], *, storage: str | None) -> None:
        import optuna  # type: ignore[import-not-found]

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        box = optuna.distributions.FloatDistribution(data.LOW, data.HIGH)
        self._study = optuna.create_study(
            storage=storage, sampler=optuna.samplers.GPSampler(seed=0), direction="maximize"
        )
        self._study.add_trials(
            [
                optuna.trial.create_trial(
                    params={"z1": z1, "z2": z2}, distributions={"z1": box, "z2": box}, value=value
                )
                for (z1, z2), value in zip(data.lattice()[nodes].tolist(), y, strict=True)
            ]
        )

    def step(self, node: int, y: float) -> None:  # the node is its own choice
        asked = self._study.ask()
        for name in ("z1", "z2"):
            asked.suggest_float(name, data.LOW, data.HIGH)
        self._study.tell(asked, y)


Maker = Callable[[list[int], list[float]], Peer]


def makers(folder: Path) -> dict[str, Maker]:
    """Return all peers by name; `folder` is for their databases."""
    made = {
        f"BoTorch, {where}, {how}": _botorch(on_lattice=where == "lattice", condition=how == "conditioned")
        for where in ("lattice", "optimize_acqf")
        for how in ("new model", "conditioned")
    }
    return {
        "scikit-learn, lattice": Scikit,
        **made,
        "Optuna, in memory": lambda nodes, y: Optuna(nodes, y, storage=None),
        "Optuna, SQLite": lambda nodes, y: Optuna(nodes, y, storage=f"sqlite:///{folder / str(len(nodes))}.db"),
    }


def _botorch(*, on_lattice: bool, condition: bool) -> Maker:
    return lambda nodes, y: Botorch(nodes, y, on_lattice=on_lattice, condition=condition)


def measured(make: Maker, n: int) -> dict[str, float | int | None]:
    """Return the median CPU ms of ask + tell after `n` observations, and the node first proposed.

    Raises:
        TooSlowError: one takes longer than the limit.

    """
    nodes, y = (values.tolist() for values in data.distinct())
    peer = make(nodes[:n], y[:n])
    times: list[float] = []
    proposed = []
    with limited(LIMIT):
        for i in range(n, n + REPEATS):
            start = time.process_time()
            proposed.append(peer.step(nodes[i], y[i]))
            times.append(time.process_time() - start)
            if times[0] > SLOW:
                break
    return {"ms": round(1000 * statistics.median(times), 3), "node": proposed[0]}


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TooSlowError in this block when it has taken so many CPU seconds."""

    def stop(_number: int, _frame: object) -> None:
        raise TooSlowError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def sizes_of(name: str, make: Maker) -> dict[int, dict[str, float | int | None]]:
    """Measure one peer by size, as far as it comes within the limit."""
    found: dict[int, dict[str, float | int | None]] = {}
    for n in data.SIZES:
        sys.stderr.write(f"  {name}, n = {n}\n")
        try:
            found[n] = measured(make, n)
        except TooSlowError:
            break
    return found


def main() -> None:
    """Measure all and print."""
    warnings.simplefilter("ignore")  # of the peers, about their own parts
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        found = {name: sizes_of(name, make) for name, make in makers(Path(folder)).items()}
    versions = {name: version(name) for name in ("scikit-learn", "torch", "botorch", "gpytorch", "optuna", "numpy")}
    sys.stdout.write(json.dumps({"versions": versions, "peers": found}) + "\n")


if __name__ == "__main__":
    main()
