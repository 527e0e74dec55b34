"""Regions with noise: false ones in at most as many campaigns as delta allows, and a case that is tight."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.stats import binom
from sklearn.gaussian_process.kernels import Matern as ScikitMatern
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.regions import SAFE, UNDECIDED, UNSAFE, Regions, divide
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.fakes.observations import an_observation

DELTA, NOISE = 0.2, 0.05
BOX, KERNEL = Lattice((0.0, 0.0), (3.0, 3.0), 7), Matern(2.5, 1.5)


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def regions(found: RigorousMethod, box: Lattice, cells: int) -> Regions:
    return divide(found.envelope, np.array(box.low), np.array(box.high), max_cells=cells)


@pytest.mark.parametrize("campaigns", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_false_regions_are_as_rare_as_delta_says(campaigns: int) -> None:
    """Functions of norm exactly B, noise of +-R, tests where the sign is most open, regions after the last test."""
    false, decided = 0, []
    oracle = ScikitMatern(KERNEL.length_scale, nu=KERNEL.nu)
    for seed in range(campaigns):
        rng = np.random.default_rng(seed)
        centres, weights = rng.uniform(0, 3, (6, 2)), rng.normal(size=6)
        weights /= math.sqrt(weights @ oracle(centres) @ weights)
        values = oracle(BOX.nodes, centres) @ weights
        premises = Premises(1.0, NOISE, DELTA, mixture(1.0, NOISE))
        found = RigorousMethod(BOX, KERNEL, premises, alpha=1e-6, unsafe_above=0.0)
        node = int(rng.integers(BOX.size))
        for _ in range(60):
            found.recall([an_observation(node, float(values[node]) + NOISE * float(rng.choice([-1, 1])))])
            node = found.propose().node
        divided = regions(found, BOX, 3_000)
        z = rng.uniform(0, 3, (2_000, 2))
        status, j = divided.at(z), oracle(z, centres) @ weights
        false += bool(((status == SAFE) & (j >= 0)).any() or ((status == UNSAFE) & (j <= 0)).any())
        decided.append(1 - divided.of(UNDECIDED))
    assert false <= binom.ppf(0.99, campaigns, DELTA)
    # Power: a band that certifies nothing would be as right.
    assert np.mean(decided) > 0.5


def test_a_tight_case_is_false_often_enough_to_show_a_wrong_factor() -> None:
    """J = 0, Gaussian noise, one start and one lambda, no room in B: the set excludes J by n = 32 nearly as often.

    An empty set counts as well: a campaign would be refuted, which is as wrong, and gives no regions.
    """
    box, kernel, delta, runs, lam = Lattice((0.0,), (1.0,), 2), Matern(2.5, 1e3), 0.5, 400, 1.0
    rng = np.random.default_rng(0)
    false = 0
    for _ in range(runs):
        found = RigorousMethod(box, kernel, Premises(1e-3, 0.1, delta, ((lam, 1.0),)), alpha=1e-6)
        wrong = False
        for count in (1, 1, 2, 4, 8, 16):
            found.recall([an_observation(0, 0.1 * float(rng.normal())) for _ in range(count)])
            wrong = wrong or regions(found, box, 100).of(UNDECIDED) < 1.0
        false += wrong
    assert delta / 10 * runs < false <= binom.ppf(0.99, runs, delta)
