"""Bets with a control: what is proven stays true whatever the disturbances do, and is more where they explain."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.control.basis import normal_basis
from perfbound.orchestrator.mathematics.control.sequence import Disturbed
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.schemas.values import Observation

MEAN, NORM, DELTA = 0.6, 0.1, 0.1
REPLICATES, TESTS = 8, 40
Law = Callable[[Floats, np.random.Generator], Floats]
"""From the scores of rollouts (b, 2) to their values in [0, 1], of mean 0.5: nothing is to spare."""
LAWS: dict[str, Law] = {
    "explained": lambda t, rng: 0.5 + 0.2 * np.tanh(t[:, 0]),
    "two values": lambda t, rng: (ndtr(t[:, 0]) < 0.5).astype(float),
    "rare": lambda t, rng: np.where(ndtr(t[:, 1]) < 0.1, 0.0, 5 / 9),
    "in part": lambda t, rng: 0.5 + 0.15 * np.tanh(t[:, 0]) + 0.3 * (rng.random(len(t)) - 0.5),
    "not at all": lambda t, rng: (rng.random(len(t)) < 0.5).astype(float),
    "together": lambda t, rng: 0.5 + 0.4 * np.sign(t[:, 0] * t[:, 1]),
}


def method(scores: dict[int, Floats] | None, *, norm: float = NORM) -> KrigingMethod:
    disturbed = None if scores is None else Disturbed((normal_basis(7),) * 2, lambda test, _: scores[test])
    return KrigingMethod(
        Lattice((0.0,), (1.0,), 5),
        # Of one value: every rollout counts for every start.
        Matern(2.5, 1e4),
        KrigingPremises(norm, -MEAN, (-1.0, 0.0), DELTA),
        spread=0.3,
        budget=KrigingBudget(TESTS, REPLICATES, 3),
        disturbed=disturbed,
    )


def campaign(
    law: Law, rng: np.random.Generator, *, controlled: bool = True, norm: float = NORM
) -> tuple[float, bool, KrigingMethod]:
    """Return the bound of the mean, and whether the sum of rollouts proved at any time more than is true."""
    scores, false = dict[int, Floats](), False
    found, cost = method(scores if controlled else None, norm=norm), -math.log(DELTA)
    for test in range(TESTS):
        scores[test] = rng.normal(size=(REPLICATES, 2))
        values = law(scores[test], rng)
        proposal = found.propose()
        bound = found.observe(proposal, Observation(-float(values.mean()), tuple((-values).tolist())))
        bets = found.bets.bounds
        if bets.rollouts:
            false |= bool((bets._sum - cost > bets._weights.sum(axis=1) * 0.5 + 1e-9).any())
    assert bound.upper is not None
    return -bound.upper, false, found


@pytest.mark.parametrize("name", LAWS)
def test_no_law_makes_more_claims_false_than_delta(name: str) -> None:
    rng = np.random.default_rng(list(name.encode()))
    campaigns = 60
    wrong = sum(campaign(LAWS[name], rng)[1] for _ in range(campaigns))
    assert wrong <= stats.binom.ppf(0.999, campaigns, DELTA)


def test_an_explained_law_is_bounded_more_closely() -> None:
    rng = np.random.default_rng(1)
    both = [
        [campaign(LAWS["explained"], rng, controlled=controlled, norm=0.4)[0] for _ in range(12)]
        for controlled in (True, False)
    ]
    assert np.median(both[0]) > np.median(both[1]) + 0.01
    lower, upper = np.quantile(both, (0.25, 0.75), axis=1)
    assert upper[0] - lower[0] < 0.5 * (upper[1] - lower[1])


def test_after_the_first_fit_the_weights_are_planned_for_what_it_leaves() -> None:
    scores, rng = dict[int, Floats](), np.random.default_rng(2)
    found = method(scores)
    assert found.outlook(10.0) is None, "no point has been tested"
    for test in range(5):
        scores[test] = rng.normal(size=(REPLICATES, 2))
        values = LAWS["explained"](scores[test], rng)
        # 320 rollouts: the first fit is after 32 of them, which are four tests.
        assert (found.control is None) == (test < 4)
        assert found.bets.spread == 0.3 if test < 4 else found.bets.spread < 0.1
        before = found.bets.bounds._planned.max() if test else 0.0
        bound = found.observe(found.propose(), Observation(-float(values.mean()), tuple((-values).tolist())))
    assert found.control is not None
    assert found.control[1] == 32
    assert found.bets.bounds._planned.max() > 0
    assert before > 0
    assert found.bets.bounds.rollouts == found.bets.means.counts.sum() == 5 * REPLICATES
    assert bound.upper is not None


def test_the_same_observations_in_one_step_or_one_by_one_are_the_same_bound() -> None:
    rng, scores = np.random.default_rng(3), dict[int, Floats]()
    one, other = method(scores), method(scores)
    tests = []
    for test in range(12):
        scores[test] = rng.normal(size=(REPLICATES, 2))
        values = LAWS["in part"](scores[test], rng)
        tests.append((one.propose(), Observation(-float(values.mean()), tuple((-values).tolist()))))
        bound = one.observe(*tests[-1])
    assert other.bound_after(tests) == bound
    assert other.bets.b_min == one.bets.b_min
