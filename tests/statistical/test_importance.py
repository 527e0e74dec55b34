"""The bound of a rare failure's probability by importance sampling, where the probability is known."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, norm

from perfbound.orchestrator.mathematics.bounds.one_law.weighted import (
    DEFENSIVE,
    importance_weight,
    weighted_failure_lower,
)

Floats = NDArray[np.float64]
DELTA, RUNS, SAMPLES = 0.05, 400, 100
P = float(norm.sf(3.0))


def bounds(fails: Callable[[Floats], Floats], centre: tuple[float, ...]) -> Floats:
    """Return the bounds of RUNS campaigns with SAMPLES rollouts around `centre`; `fails` takes scores (n, k)."""
    rng, found = np.random.default_rng(39), []
    for _ in range(RUNS):
        scores = rng.standard_normal((SAMPLES, len(centre)))
        scores[rng.random(SAMPLES) >= DEFENSIVE] += centre
        weights = [importance_weight(row, centre) for row in scores[fails(scores) > 0].tolist()]
        found.append(weighted_failure_lower(weights, SAMPLES, DELTA))
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "fails", "centre", "exact", "least"),
    [
        ("a half-space around its design point", lambda t: t[:, 0] > 3.0, (3.0, 0.0), P, 0.4),
        ("a corner", lambda t: (t > 2.0).all(axis=1), (2.0, 2.0), float(norm.sf(2.0)) ** 2, 0.3),
        ("from too far out", lambda t: t[:, 0] > 3.0, (5.0, 0.0), P, 0.0),
        ("from beside it", lambda t: t[:, 0] > 3.0, (3.0, 2.0), P, 0.0),
        ("one of two failures", lambda t: abs(t[:, 0]) > 3.0, (3.0, 0.0), 2 * P, 0.2),
        ("often, elsewhere", lambda t: t[:, 0] < 1.0, (3.0, 0.0), float(norm.cdf(1.0)), 0.0),
    ],
)
def test_it_is_right_and_of_use(
    name: str, fails: Callable[[Floats], Floats], centre: tuple[float, ...], exact: float, least: float
) -> None:
    found = bounds(fails, centre)
    # More wrong bounds than this have a probability of 1e-4, if each is right with probability 1 - DELTA.
    assert (found > exact).sum() <= binom.isf(1e-4, RUNS, DELTA), name
    assert np.median(found) >= least * exact, name


def test_the_level_is_not_that_of_a_wrong_weight() -> None:
    """Weights that are twice the right ones are noticed: the bound of the half-space is then wrong as a rule."""
    rng, wrong = np.random.default_rng(40), 0
    for _ in range(40):
        scores = rng.standard_normal((4 * SAMPLES, 1))
        scores[rng.random(4 * SAMPLES) >= DEFENSIVE] += 3.0
        weights = [2.0 * importance_weight(row, (3.0,)) for row in scores[scores[:, 0] > 3.0].tolist()]
        wrong += weighted_failure_lower(weights, 4 * SAMPLES, DELTA) > P
    assert wrong > 30
