"""TuRBO-1 on BoTorch, for one start at a time; written after the tutorial of BoTorch and [EPT].

[EPT] D. Eriksson, M. Pearce, J. R. Gardner, R. D. Turner, M. Poloczek: Scalable global optimization via local Bayesian
optimization. NeurIPS 2019.

A trust region around the best start doubles after `SUCCESSES` better ones in a row and halves after max(4, p) that are
not better. A start is that of a Thompson sample of the model among candidates in the region. When the region is too
small the search begins again. Deviation: 2000 candidates, where the tutorial has up to 5000 above ten parameters.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import torch  # type: ignore[import-not-found]
from botorch.fit import fit_gpytorch_mll  # type: ignore[import-not-found]
from botorch.generation import MaxPosteriorSampling  # type: ignore[import-not-found]
from botorch.models import SingleTaskGP  # type: ignore[import-not-found]
from gpytorch.constraints import Interval  # type: ignore[import-not-found]
from gpytorch.kernels import MaternKernel, ScaleKernel  # type: ignore[import-not-found]
from gpytorch.likelihoods import GaussianLikelihood  # type: ignore[import-not-found]
from gpytorch.mlls import ExactMarginalLogLikelihood  # type: ignore[import-not-found]

FIRST, LEAST, LARGEST = 0.8, 0.5**7, 1.6
"""Edge of the trust region, in shares of a range."""
SUCCESSES = 10
CANDIDATES = 2000
MOVED = 20
"""Parameters of a candidate that differ from the best start, about."""


def search(objective: Callable[[Any], float], dimension: int, seed: int) -> None:
    """Ask for points of the unit box until the objective raises."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    while True:
        _one_region(objective, dimension)


def _one_region(objective: Callable[[Any], float], dimension: int) -> None:
    """Search until the trust region is too small; the values are maximised, so they are negative robustness."""
    x = _sobol(dimension, 2 * dimension)
    y = torch.tensor([-objective(point.tolist()) for point in x], dtype=torch.double)
    edge, better, worse, patience = FIRST, 0, 0, max(4, dimension)
    while edge >= LEAST:
        point = _candidate(x, y, edge)
        value = -objective(point.tolist())
        success = value > y.max() + 1e-3 * abs(y.max())
        better, worse = (better + 1, 0) if success else (0, worse + 1)
        if better == SUCCESSES:
            edge, better = min(2 * edge, LARGEST), 0
        elif worse == patience:
            edge, worse = edge / 2, 0
        x, y = torch.cat([x, point[None]]), torch.cat([y, torch.tensor([value], dtype=torch.double)])


def _candidate(x: Any, y: Any, edge: float) -> Any:
    """Return the next point (p,), given points (n, p) and values (n,)."""
    dimension = x.shape[1]
    spread = y.std()
    values = ((y - y.mean()) / (spread if spread > 0 else 1.0))[:, None]
    matern = MaternKernel(nu=2.5, ard_num_dims=dimension, lengthscale_constraint=Interval(0.005, 4.0))
    likelihood = GaussianLikelihood(noise_constraint=Interval(1e-8, 1e-3))
    model = SingleTaskGP(x, values, covar_module=ScaleKernel(matern), likelihood=likelihood, outcome_transform=None)
    with suppress(Exception):  # a model whose fit fails keeps its first length scales
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    weights = matern.lengthscale.detach().squeeze(0)
    weights = weights / weights.prod().pow(1.0 / dimension)
    best = x[y.argmax()]
    low, high = ((best + sign * weights * edge / 2).clamp(0.0, 1.0) for sign in (-1, 1))
    moved = torch.rand(CANDIDATES, dimension) <= min(1.0, MOVED / dimension)
    still = torch.nonzero(moved.sum(dim=1) == 0).ravel()
    moved[still, torch.randint(dimension, (len(still),))] = True
    among = torch.where(moved, low + (high - low) * _sobol(dimension, CANDIDATES), best)
    with torch.no_grad():
        return MaxPosteriorSampling(model=model, replacement=False)(among, num_samples=1)[0]


def _sobol(dimension: int, count: int) -> Any:
    """Return points (count, p) of a scrambled sequence."""
    engine = torch.quasirandom.SobolEngine(dimension, scramble=True, seed=int(torch.randint(2**31, ())))
    return engine.draw(count, dtype=torch.double)
