"""Laws of robustness with exact moments, for one starting condition each. Nothing here knows the orchestrator.

| symbol  | name          | meaning                                        | unit               |
|---------|---------------|------------------------------------------------|--------------------|
| [-m, M] | `CLIP`        | range of the robustness                        | unit of robustness |
| r       | `RISK_WEIGHT` | weight of the standard deviation               | -                  |
| c, s    | `CONSTANTS`   | of the linearised risk                         | unit of robustness |
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import cauchy, norm

CLIP, RISK_WEIGHT, CONSTANTS = (-0.05, 0.75), 0.2, (0.6, 0.1)

Floats = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int], Floats]


class Law(NamedTuple):
    """A sampler, and atoms with probabilities for its exact moments."""

    draw: Draw
    atoms: Floats
    weights: Floats

    @property
    def mean(self) -> float:
        """E rho."""
        return float(self.weights @ self.atoms)

    @property
    def sd(self) -> float:
        """Standard deviation of rho."""
        return float(np.sqrt(self.weights @ (self.atoms - self.mean) ** 2))

    @property
    def linearised(self) -> float:
        """E[X], X = rho - (r/2)((rho - c)^2/s + s)."""
        c, s = CONSTANTS
        return float(self.weights @ (self.atoms - RISK_WEIGHT / 2 * ((self.atoms - c) ** 2 / s + s)))


def gaussian(mean: float, sd: float) -> Law:
    """Return a clipped normal law; its moments by quadrature over 20,000 cells."""
    edges = np.linspace(*CLIP, 20_001)
    inner = np.diff(norm.cdf(edges, mean, sd))
    atoms = np.concatenate(([CLIP[0]], (edges[1:] + edges[:-1]) / 2, [CLIP[1]]))
    weights = np.concatenate(([norm.cdf(CLIP[0], mean, sd)], inner, [norm.sf(CLIP[1], mean, sd)]))
    return Law(lambda rng, n: np.clip(rng.normal(mean, sd, n), *CLIP), atoms, weights)


def discrete(atoms: list[float], weights: list[float]) -> Law:
    """Return a law on finitely many values."""
    places, chances = np.array(atoms), np.array(weights)
    return Law(lambda rng, n: rng.choice(places, n, p=chances), places, chances)


def skewed(fall: float) -> Law:
    """Return mostly good rollouts, some poor, and a `fall` now and then at the lower end of the clip."""
    return discrete([-0.05, 0.3, 0.62, 0.7], [fall, 0.1, 0.3, 0.6 - fall])


LAWS: dict[str, tuple[Law, Law]] = {  # (the worst start, the others where they are better)
    "Gaussian, clipped": (gaussian(0.6, 0.1), gaussian(0.65, 0.08)),
    "two points": (discrete([-0.05, 0.75], [0.3, 0.7]), discrete([-0.05, 0.75], [0.2, 0.8])),
    "skewed": (skewed(0.05), skewed(0.02)),
}


def extreme_risk(mean: Floats | float) -> Floats:
    """Return E - r sd of a law on the two ends of the clip with this mean: no law on the clip spreads more."""
    low, high = CLIP
    return np.asarray(mean - RISK_WEIGHT * np.sqrt(np.maximum((high - mean) * (mean - low), 0.0)), dtype=np.float64)


def draw_extremes(rng: np.random.Generator, mean: float, count: int) -> Floats:
    """Return `count` rollouts of that law."""
    low, high = CLIP
    return np.asarray(np.where(rng.random(count) < (mean - low) / (high - low), high, low), dtype=np.float64)


class Sampled(NamedTuple):
    """A law of the robustness of a random start: a sampler and what is true of it."""

    draw: Draw
    failure: float
    """P(v < 0)."""
    tenth: float
    """inf{t: P(v <= t) >= .1}."""
    atoms: Floats | None = None
    weights: Floats | None = None
    """Of a law on the clip; None for one without bounds."""

    @property
    def bounded(self) -> bool:
        """Whether the law is on the clip, so that it has a CVaR and a risk."""
        return self.atoms is not None

    def cvar(self, share: float) -> float:
        """Return the mean of the worst share, the largest t - E[(t - v)^+]/share; it is attained at an atom."""
        assert self.atoms is not None
        assert self.weights is not None
        short = np.maximum(self.atoms[:, None] - self.atoms, 0) @ self.weights
        return float((self.atoms - short / share).max())

    def risk(self, risk_weight: float) -> float:
        """Return E - r sd."""
        assert self.atoms is not None
        assert self.weights is not None
        mean = self.weights @ self.atoms
        return float(mean - risk_weight * np.sqrt(self.weights @ (self.atoms - mean) ** 2))


def on_the_clip(places: list[float], chances: list[float]) -> Sampled:
    """Return a law on finitely many values in ascending order, with all that is true of it."""
    law = discrete(places, chances)
    reached = np.cumsum(law.weights) >= 0.1 - 1e-12
    return Sampled(
        law.draw, float(law.weights[law.atoms < 0].sum()), float(law.atoms[reached][0]), law.atoms, law.weights
    )


FINE = np.linspace(*CLIP, 401)

SAMPLED: dict[str, Sampled] = {
    "uniform, fine atoms": on_the_clip(FINE.tolist(), [1 / 401] * 401),
    "heavy atoms": on_the_clip([-0.05, 0.3, 0.62, 0.7], [0.03, 0.1, 0.3, 0.57]),
    "a jump at the tenth": on_the_clip([-0.02, 0.6], [0.1, 0.9]),
    "rare failures": on_the_clip([-0.05, 0.7], [0.002, 0.998]),
    "nearly always failing": on_the_clip([-0.05, 0.75], [0.99, 0.01]),
    "two points": on_the_clip([-0.05, 0.75], [0.5, 0.5]),
    "normal": Sampled(lambda rng, n: rng.normal(1, 1, n), float(norm.cdf(-1)), float(norm.ppf(0.1, 1, 1))),
    "Cauchy": Sampled(lambda rng, n: 3 + rng.standard_cauchy(n), float(cauchy.cdf(-3)), float(cauchy.ppf(0.1, 3))),
}
