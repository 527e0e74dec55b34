"""Several requirements from one design: every claim has the whole delta, and mistakes that would break one are found.

The second half runs the method that a campaign file makes, with its own division of an observation among the methods.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.campaign.methods import method
from perfbound.orchestrator.campaign.observation import Observer, by_requirement
from perfbound.orchestrator.campaign.plan import ProblemPlan, plan
from perfbound.orchestrator.mathematics.bounds.joint import JointMethod
from perfbound.schemas.result.facts import Header
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.schemas.values import Bound, Observation
from tests.fakes.simulators import robustness, spec
from tests.studies.coverage import requirements
from tests.studies.coverage.oracle import ROUNDING
from tests.studies.coverage.requirements import Requirements, in_order

DELTA = 0.05
CLAIMS = ("every", "first", "last")
TIGHT = Requirements("scenario", "two points", "same", scale=10.0, size=1)
ROWS = {
    "tight": TIGHT,
    "five": Requirements("scenario", "two points", "same", number=5, size=1, tests=15),
    "apart": Requirements("scenario", "skewed", "apart", size=2, window=8, tests=15),
    "kernel": Requirements("rigorous", "Gaussian", "flat", scale=10.0, size=2, noise_scale=0.1, tests=15),
}
KERNEL = Requirements("rigorous", "+-R", "apart", scale=10.0, size=25, noise_scale=0.02, tests=12)


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def most(campaigns: int) -> float:
    """Return the largest number of false claims among them; 67 of 1,000."""
    return float(binom.ppf(0.99, campaigns, DELTA))


def false(row: Requirements, campaigns: int, **told: Any) -> dict[str, int]:
    found = [requirements.campaign(row, np.random.default_rng(seed), **told) for seed in range(campaigns)]
    return {claim: sum(bool(each[claim]) for each in found) for claim in CLAIMS}


@pytest.mark.parametrize("campaigns", [100, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ROWS)
def test_no_claim_is_false_more_often_than_the_whole_delta(name: str, campaigns: int) -> None:
    found = false(ROWS[name], campaigns)
    assert max(found.values()) <= most(campaigns)


@pytest.mark.slow
def test_the_tight_row_is_false_often_enough_to_show_a_wrong_factor() -> None:
    found = false(TIGHT, 1000)
    assert min(found.values()) > DELTA / 10 * 1000
    assert found["every"] <= most(1000) == 67


def test_a_delta_that_is_multiplied_by_ten_is_found() -> None:
    assert false(TIGHT, 100, told=10 * DELTA)["every"] > most(100)


def test_bounds_from_the_observations_of_the_other_requirement_are_found() -> None:
    def exchanged(observation: Observation) -> list[Observation]:
        return in_order(observation, 2)[::-1]

    found = false(KERNEL, 20, split=exchanged)
    assert min(found["every"], found["first"], found["last"]) > most(20)
    assert max(false(KERNEL, 20).values()) <= most(20)


CHANCES, LEAST = (0.7, 0.5), (0.5, 0.3)
"""Chances of the value 1, else 0, at two starts; so the least means of the value and of 1 minus the value."""


def of_a_file() -> tuple[ProblemPlan, Header, Observer]:
    """Return what a campaign file makes: the value and 1 minus the value are two requirements at two starts."""
    config = robustness(
        {"method": "scenario", "alpha": 0.01, "delta": DELTA},
        specification=None,
        specifications=[
            {"name": "large", "formula": "value >= 0"},
            {"name": "not-large", "formula": "1 - value >= 0"},
        ],
        space={"scenarios": [[0.0, 0.0], [1.0, 1.0]]},
        clip=(0.0, 1.0),
        replicates=5,
    )
    found = Header.new(config, spec(noisy=True), {}, run="0" * 16)
    return plan(config, found.spec, config.problems[0]), found, Observer(config, found.spec)


def false_of_a_file(campaigns: int) -> dict[str, int]:
    """Return how many claims are false after 15 tests."""
    planned, header, observer = of_a_file()
    false = dict.fromkeys(CLAIMS, 0)
    for seed in range(campaigns):
        rng, whole, bound = np.random.default_rng(seed), method(planned, header), Bound(None, None, None)
        assert isinstance(whole, JointMethod)
        for test in range(15):
            proposal = whole.propose(None if test else 0)
            values = rng.random(planned.replicates) < CHANCES[proposal.node]
            rollouts = {
                key: Trajectory(("t", "value"), np.array([[0.0, float(value)]]))
                for key, value in zip(planned.rollouts, values, strict=True)
            }
            bound = whole.observe(proposal, observer.observe(planned, rollouts))
        limits = {"every": min(LEAST), "first": LEAST[0], "last": LEAST[1]}
        for claim, each in zip(CLAIMS, (bound, *whole.bounds), strict=True):
            assert each.upper is not None
            false[claim] += -each.upper > limits[claim] + ROUNDING
    return false


@pytest.mark.parametrize("campaigns", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_method_of_a_file_claims_no_more_than_its_delta_allows(campaigns: int) -> None:
    assert max(false_of_a_file(campaigns).values()) <= most(campaigns)


def test_a_file_whose_requirements_are_exchanged_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def exchanged(planned: ProblemPlan, observation: Observation) -> list[Observation]:
        return by_requirement(planned, observation)[::-1]

    monkeypatch.setattr("perfbound.orchestrator.campaign.methods.by_requirement", exchanged)
    assert false_of_a_file(100)["last"] > most(100)
