"""CPU milliseconds of one proposal, one observation and the bound (ask + tell + bound) of method `rigorous`."""

import statistics
import time

import numpy as np

from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.fakes.observations import an_observation
from tests.studies.benchmarks import data
from tests.studies.benchmarks.parts.proposal import Peers, best_beside
from tests.studies.benchmarks.report import Row

SIZES = data.SIZES[:3]
KINDS = ("ucb", "spread")
"""Kinds of campaign.

`ucb` observes what the method proposes, as a campaign does: points repeat and are merged. `spread` observes new
places as long as there are any, the dearest data there can be.
"""
REPEATS = 5


def main(peers: Peers) -> list[Row]:
    """Return the median CPU ms by kind and size; the peers only ask and tell, on the same lattice."""
    return [
        best_beside(f"rigorous, n = {n}: {kind}, ask + tell + bound", milliseconds, peers, n)
        for kind in KINDS
        for n, milliseconds in _measure(data.RESOLUTION, kind).items()
    ]


class _Campaign:
    """A campaign on the paper's test function that never converges."""

    def __init__(self, resolution: int, *, spread: bool) -> None:
        lattice = Lattice((0.0, 0.0), (5.0, 5.0), resolution)
        self._values = np.sin(lattice.nodes[:, 0]) * np.cos(lattice.nodes[:, 1]) / 2
        self._rng = np.random.default_rng(0)
        self._order = self._rng.permutation(lattice.size).tolist() if spread else None
        self.method = RigorousMethod(
            lattice,
            Matern(nu=10, length_scale=1.0),
            Premises(1.5, 0.005, 0.05, mixture(1.5, 0.005)),
            alpha=1e-3,
        )

    def step(self) -> None:
        """Ask, tell and bound."""
        index = self.method.propose(None if self.method._data.n else 0).node
        index = index if self._order is None else self._order[self.method._data.n]
        self.method.observe(*an_observation(index, self._y(index)))
        self.method.bound()

    def fill(self, n: int) -> None:
        """Bring it to n observations; spread ones without the bounds on the way, which the next step does not need."""
        while self.method._data.n < n:
            if self._order is None:
                self.step()
            else:
                index = self._order[self.method._data.n]
                self.method._data.append(index, self._y(index))

    def _y(self, index: int) -> float:
        return float(self._values[index] + self._rng.normal(0, 0.005))


def _measure(resolution: int, kind: str) -> dict[int, float]:
    campaign = _Campaign(resolution, spread=kind == "spread")
    return {n: _median(campaign, n) for n in SIZES}


def _median(campaign: _Campaign, n: int) -> float:
    campaign.fill(n)
    campaign.step()  # whose proposal uses older data after a fill
    times = []
    for _ in range(REPEATS):
        start = time.process_time_ns()
        campaign.step()
        times.append((time.process_time_ns() - start) / 1e6)
    return round(statistics.median(times), 3)
