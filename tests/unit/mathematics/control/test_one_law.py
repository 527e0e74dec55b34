"""Controls of values of one law: they keep means and cost range, and no division into pieces changes a bound."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.one_law.betting import BettingSequence
from perfbound.orchestrator.mathematics.bounds.one_law.predictable import (
    CvarSequence,
    PredictableSequence,
    RiskSequence,
)
from perfbound.orchestrator.mathematics.bounds.sample import SampleMethod, Terms
from perfbound.orchestrator.mathematics.bounds.scenario import Risk, ScenarioMethod
from perfbound.orchestrator.mathematics.control.basis import choice_basis, normal_basis
from perfbound.orchestrator.mathematics.control.one_law import LawControl
from perfbound.orchestrator.mathematics.control.sequence import Disturbed
from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import Observation, Proposal, SampledQuantity
from tests.studies.coverage.controls.campaigns import Bounds, Controls, campaign
from tests.studies.coverage.oracle import allowed

BASES = (normal_basis(7), choice_basis((0.3, 0.7)))
CLIP = (0.0, 1.0)


def drawn(rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """Return scores (n, 2) and values in [0, 1] that they explain nearly, of mean .6."""
    scores = np.column_stack([rng.normal(size=count), rng.random(count) < 0.7])
    rest = 0.01 * rng.uniform(-1.0, 1.0, count)
    return scores, 0.6 + 0.15 * np.tanh(scores[:, 0]) + 0.1 * (scores[:, 1] - 0.7) + rest


def disturbed(planned: int) -> Disturbed:
    """Return disturbances whose scores are given with the values."""
    return Disturbed(BASES, lambda _, __: np.empty(0), planned)


def fitted(count: int = 64, planned: int = 4000) -> LawControl:
    law = LawControl(disturbed(planned), CLIP, 0.05)
    law.add(*drawn(np.random.default_rng(1), count), lambda: 0.6)
    return law


def test_a_control_has_the_mean_0_and_the_ends_that_it_says() -> None:
    law = fitted()
    assert law.control is not None
    assert law.before_fit == 64
    weights = [basis.means for basis in BASES]
    assert [math.fsum((a * b).tolist()) for a, b in zip(weights, law._levels, strict=True)] == pytest.approx([0.0, 0.0])
    scores, values = drawn(np.random.default_rng(2), 20_000)
    g = law.g(scores)
    assert law.least <= g.min() < g.max() <= law.most
    assert abs(g.mean()) < 4 * g.std() / math.sqrt(len(g))
    assert np.std(values - g) < 0.3 * np.std(values)
    assert (law.g(scores.reshape(-1, 4, 2)) == g.reshape(-1, 4).mean(axis=1)).all()


def test_it_is_not_used_where_its_range_costs_more_than_the_noise() -> None:
    few = fitted(planned=60)
    assert few.has_begun
    assert (few.control, few.least, few.most, few.ahead > 1000) == (None, 0.0, 0.0, True)


def test_a_sequence_takes_the_ends_that_it_was_given() -> None:
    sequence, past = BettingSequence((0.05,)), np.array([[0.6, 0.01, 0.01]])
    sequence.reach(-0.2, 1.1)
    sequence.observe_each(np.array([-0.2]), past)
    with pytest.raises(ValueError, match=r"in \[-0.2, 1.1\]"):
        sequence.observe_each(np.array([-0.21]), past)


SEQUENCES: dict[str, Callable[[Disturbed | None], PredictableSequence]] = {
    "mean": lambda law: CvarSequence(1.0, CLIP, delta=0.05, disturbed=law),
    "CVaR": lambda law: CvarSequence(0.5, CLIP, delta=0.05, disturbed=law),
    "risk": lambda law: RiskSequence(0.2, CLIP, delta=0.05, disturbed=law),
}


@pytest.mark.parametrize("name", SEQUENCES)
def test_no_division_into_pieces_changes_a_bound_and_it_is_a_better_one(name: str) -> None:
    law, rng = disturbed(3000), np.random.default_rng(3)
    scores, values = drawn(rng, 3000)
    without, whole, pieces = SEQUENCES[name](None), SEQUENCES[name](law), SEQUENCES[name](law)
    without.add_each(values)
    whole.add_each(values, scores)
    for part in np.split(np.arange(3000), np.sort(rng.choice(3000, 200, replace=False))):
        pieces.add_each(values[part], scores[part])
    assert whole.lower() == pieces.lower()
    assert whole.estimate == pieces.estimate
    assert whole.lower() > without.lower() + 0.001
    assert whole.control is not None
    assert whole.control[0].residual < 0.5 * whole.control[0].before


def test_blocks_of_samples_are_as_one_test_after_the_other() -> None:
    scores, values = drawn(np.random.default_rng(4), 900)
    known = Disturbed(BASES, lambda test, _: scores.reshape(300, 3, 2)[test], 300)
    quantities: tuple[SampledQuantity, ...] = ("mean", "risk", "failure_probability")
    terms = [Terms(each, 0.05, clip=CLIP, risk_weight=0.2, disturbed=known) for each in quantities]
    one, block = (SampleMethod(terms, lambda _: (0.0,), fixed=None, largest=False) for _ in range(2))
    each = np.clip(values, *CLIP).reshape(300, 3)
    for row in each:
        one.observe(Proposal(0, (0.0,), None, None, None, None), Observation(0.0, tuple(row.tolist())))
    block.recall_each(np.arange(100), np.zeros(100), each[:100])
    block.observe_each(np.arange(100, 300), np.zeros(200), each[100:])
    assert [one.found(k) for k in range(3)] == [block.found(k) for k in range(3)]
    assert one.control is not None


@pytest.mark.parametrize("bounds", ["scenario", "mean", "risk"])
def test_no_adversary_makes_more_claims_false_than_delta(bounds: Bounds) -> None:
    row = Controls(bounds, "against the control")
    found = [campaign(row, np.random.default_rng(number)) for number in range(20)]
    assert sum(each["lower"] for each in found) <= allowed(20, row.claimed)


@pytest.mark.parametrize("risk", ["mean", "linearised", "bhatia-davis", "predictable"])
def test_scenarios_are_bounded_more_closely_from_both_sides(risk: Risk) -> None:
    scores, values = drawn(np.random.default_rng(6), 3000)
    scores, each = scores.reshape(100, 30, 2), values.reshape(100, 30)
    off, on, block = (
        ScenarioMethod(
            Points(((0.0,),)),
            clip=CLIP,
            risk_weight=0.2,
            delta=0.05,
            alpha=1e-6,
            risk=risk,
            constants=(0.6, 0.13) if risk == "linearised" else None,
            disturbed=Disturbed(BASES, lambda test, _: scores[test], 3000) if controlled else None,
        )
        for controlled in (False, True, True)
    )
    proposal = on.propose()
    for row in each:
        off.observe(proposal, Observation(0.0, tuple(row.tolist())))
        on.observe(proposal, Observation(0.0, tuple(row.tolist())))
    block.observe_each(np.zeros(100, dtype=np.int64), np.zeros(100), each)
    assert block.bound() == on.bound()
    assert on.bound().ell > off.bound().ell + 0.0005
    # That of `predictable` is about the mean of all values as they are.
    assert on.bound().upper <= off.bound().upper - (0.0 if risk == "predictable" else 0.0005)
    assert on.control is not None
    assert off.control is None
    assert on.bound().scenarios[0].rollouts == 3000
