"""Method `rigorous`: how often the band, the bound or a refutation is wrong, over campaigns on functions of known norm.

The functions and noises are made here, with scikit-learn's kernel. `pytest -s` shows the table.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from sklearn.gaussian_process.kernels import Matern as ScikitMatern
from threadpoolctl import threadpool_limits

from orchestrator.bounds.rigorous import RigorousMethod
from orchestrator.gp.kernels import Matern
from orchestrator.gp.lattice import Lattice

CAMPAIGNS, TESTS, DELTA, NORM, R = 200, 20, 0.1, 1.0, 0.2
LENGTH, NU = 1.5, 2.5
LATTICE = Lattice((0.0, 0.0), (5.0, 5.0), 6)
FINE = np.stack(np.meshgrid(np.linspace(0, 5, 26), np.linspace(0, 5, 26), indexing="ij"), axis=-1).reshape(-1, 2)
ORACLE = ScikitMatern(LENGTH, nu=NU)
MIX = ((0.04, 0.5), (0.4, 0.5))
ALLOWED = CAMPAIGNS * DELTA + 3.0 * math.sqrt(CAMPAIGNS * DELTA * (1.0 - DELTA))

Draw = Callable[[np.random.Generator, int], float]
NOISES: dict[str, Draw] = {
    "gaussian": lambda rng, z: rng.normal(0, R),
    "+-R": lambda rng, z: rng.choice([-R, R]),
    # Centred, within an interval of length 2R, so R-sub-Gaussian by Hoeffding's lemma; rarely large.
    "skewed": lambda rng, z: 2 * R * (0.9 if rng.random() < 0.1 else -0.1),
    "depends on z": lambda rng, z: rng.normal(0, R if z % 2 else R / 10),
}


@dataclass
class Row:
    """Campaigns of which something was wrong at some time, and the mean final width."""

    band: int = 0
    bound: int = 0
    refuted: int = 0
    width: float = 0.0


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def function(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """A random function of norm exactly NORM."""
    centres, weights = rng.uniform(0, 5, (6, 2)), rng.normal(size=6)
    weights *= NORM / math.sqrt(weights @ ORACLE(centres) @ weights)
    return lambda z: np.asarray(ORACLE(z, centres) @ weights)


def campaign(seed: int, noise: Draw, window: int, row: Row, norm: float = NORM) -> None:
    rng = np.random.default_rng(seed)
    j = function(rng)
    values, top = j(LATTICE.nodes), float(j(FINE).max())
    method = RigorousMethod(
        LATTICE,
        Matern(NU, LENGTH),
        rkhs_norm=norm,
        noise_scale=R,
        delta=DELTA,
        alpha=0.02,
        regularisers=MIX,
    )
    flying = [method.propose(int(rng.integers(LATTICE.size))).index]
    band = False
    for _ in range(TESTS):
        while len(flying) < window:
            flying.append(method.propose(None, flying).index)
        z = flying.pop(0)
        method.observe(z, float(values[z]) + float(noise(rng, z)))
        upper, lower = method.envelope.at(LATTICE.nodes)
        band |= bool((values > upper).any() or (values < lower).any())
        if window == 1:
            flying.append(method.propose().index)
    bound = method.bound()
    row.band += band
    row.bound += not bound.lower <= top <= bound.upper
    row.refuted += bound.status == "refuted"
    row.width += (bound.upper - bound.lower) / CAMPAIGNS


@pytest.mark.parametrize("window", [1, 8])
@pytest.mark.parametrize("noise", NOISES)
def test_coverage(noise: str, window: int) -> None:
    row = Row()
    for seed in range(CAMPAIGNS):
        campaign(seed, NOISES[noise], window, row)
    print(f"\n| {noise:12s} | {window} | {row.band} | {row.bound} | {row.refuted} | {row.width:.3f} |")  # noqa: T201
    for wrong in (row.band, row.bound, row.refuted):
        assert wrong <= ALLOWED


def test_a_norm_four_times_too_small_is_noticed() -> None:
    """The oracle can tell: with a false premise, the same table shows violations."""
    row = Row()
    for seed in range(40):
        campaign(seed, lambda rng, z: rng.normal(0, R / 10), 1, row, norm=NORM / 4)
    print(f"\n| B/4, 40 runs | 1 | {row.band} | {row.bound} | {row.refuted} | - |")  # noqa: T201
    assert row.band + row.bound + row.refuted >= 20
