"""Wealth of bets on values less a control: its mean is at most 1 after each past, and mistakes are caught.

A run continues one of several pasts, to which the control was fitted. The slow tests have the full sizes.
"""

import math
from collections.abc import Callable
from copy import deepcopy

import numpy as np
import pytest
from scipy.special import ndtr

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.bounds.one_law.betting import BettingSequence
from perfbound.orchestrator.mathematics.bounds.one_law.wealth import GRID
from perfbound.orchestrator.mathematics.control.basis import normal_basis
from perfbound.orchestrator.mathematics.control.one_law import LawControl
from perfbound.orchestrator.mathematics.control.sequence import Disturbed
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.statistical.test_martingales import SIZES, is_at_most_one

MEAN, PAST, VALUES = 0.5, 32, 8
"""Of the values of one run, of which all but the last 8 are its past."""
PASTS = 10
BASES = (normal_basis(2),)
"""So few that a fit is far from what it is fitted to."""
AIMED = np.array([[0.65, 0.01, 0.0]] * VALUES)
"""The moments that the bets aim at: as large as they may be."""
Law = Callable[[Floats, np.random.Generator], Floats]


def bowl(t: Floats) -> Floats:
    """Return the values that mislead a straight line most: what it takes from those it was fitted to is not 0."""
    inside, density = 2.0 * float(ndtr(2.5)) - 1.0, math.exp(-(2.5**2) / 2) / math.sqrt(2 * math.pi)
    square = inside - 2 * 2.5 * density + 2.5**2 * (1 - inside)
    return np.asarray(MEAN - 0.07 * (np.clip(t[:, 0], -2.5, 2.5) ** 2 - square))


LAWS: dict[str, Law] = {
    "straight": lambda t, _: MEAN + 0.15 * np.clip(t[:, 0], -3, 3),
    "bowl": lambda t, _: bowl(t),
    "two points": lambda t, rng: (rng.random(len(t)) < MEAN).astype(np.float64),
}


def fitted(t: Floats, x: Floats) -> LawControl:
    control = LawControl(Disturbed(BASES, lambda _, __: t, 512), (0.0, 1.0), 0.05)
    control.add(t, x, lambda: MEAN)
    return control


def wealth(control: LawControl, x: Floats, g: Floats) -> float:
    """Return the wealth of bets on x - g against the mean that is true."""
    sequence = BettingSequence((1e-300,))
    sequence.reach(-control.most, 1.0 - control.least)
    sequence.observe_each(x - g, AIMED)
    return float(sequence.wealth()[round(MEAN * GRID)])


def continued(law: Law, runs: int, *, shift: float = 0.0) -> Floats:
    """Return the wealth of runs; with a mistake g has a mean of -shift."""
    rng, found = np.random.default_rng(1), []
    for _ in range(PASTS):
        t = rng.standard_normal((PAST, 1))
        control = fitted(t, law(t, rng))
        for _ in range(runs // PASTS):
            t = rng.standard_normal((VALUES, 1))
            found.append(wealth(control, law(t, rng), control.g(t) - shift))
    return np.array(found)


@pytest.mark.parametrize("runs", SIZES)
@pytest.mark.parametrize("name", LAWS)
def test_the_mean_wealth_is_at_most_one(name: str, runs: int) -> None:
    assert is_at_most_one(continued(LAWS[name], runs))


def test_functions_whose_mean_is_off_by_a_hundredth_are_caught() -> None:
    assert not is_at_most_one(continued(LAWS["straight"], 10_000, shift=0.01))


def test_a_control_that_is_fitted_to_its_own_values_is_caught() -> None:
    rng, found = np.random.default_rng(2), []
    for _ in range(6_000):
        t = rng.standard_normal((PAST, 1))
        x = bowl(t)
        control, own = fitted(t, x), slice(PAST - VALUES, PAST)
        found.append(wealth(control, x[own], control.g(t[own])))
    assert not is_at_most_one(np.array(found))


# Method kriging


def after_the_first_fit(rng: np.random.Generator, law: Law, scores: list[Floats]) -> KrigingMethod:
    """Return a method whose control was fitted to four tests; it reads the scores of a test from the list."""
    found = KrigingMethod(
        Lattice((0.0,), (1.0,), 3),
        Matern(2.5, 1e4),
        KrigingPremises(0.1, -0.6, (-1.0, 0.0), 0.05),
        spread=0.2,
        budget=KrigingBudget(64, VALUES, 3),
        disturbed=Disturbed(BASES, lambda test, _: scores[test]),
    )
    for test in range(PAST // VALUES):
        scores.append(rng.standard_normal((VALUES, 1)))
        observe(found, test, law(scores[-1], rng))
    return found


def observe(method: KrigingMethod, test: int, x: Floats) -> Floats:
    """Add a test, and return the logarithm of the wealth of every node against the mean that is true."""
    node = np.array([method.design.nodes[method.design.order[test]]])
    method.recall_each(node, np.zeros(1), -x[None])
    bounds = method.bets.bounds
    return np.asarray(bounds._sum - bounds._weights.sum(axis=1) * MEAN)


@pytest.mark.parametrize("runs", SIZES)
@pytest.mark.parametrize("name", ["straight", "bowl"])
def test_the_mean_wealth_of_weighted_sums_is_at_most_one(name: str, runs: int) -> None:
    rng, law = np.random.default_rng(3), LAWS[name]
    for _ in range(PASTS // 2):
        scores: list[Floats] = []
        past, found = after_the_first_fit(rng, law, scores), []
        bounds = past.bets.bounds
        before = bounds._sum - bounds._weights.sum(axis=1) * MEAN
        for _ in range(runs // PASTS):
            scores[PAST // VALUES :] = [rng.standard_normal((VALUES, 1))]
            one = deepcopy(past, {id(scores): scores})
            found.append(np.exp(observe(one, PAST // VALUES, law(scores[-1], rng)) - before))
        assert all(is_at_most_one(column) for column in np.array(found).T)
