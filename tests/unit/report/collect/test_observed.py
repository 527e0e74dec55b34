"""The columns of very many tests: the worst ones, and a choice of the others."""

import pytest

from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.report.collect import observed
from perfbound.orchestrator.report.collect.observed import observed_series, worst_first
from perfbound.orchestrator.report.collect.recorded_tests import ObservedTests, ProposedTests
from perfbound.schemas.result.facts import BoundFact, ObservationFact, ProposalFact
from perfbound.schemas.values import Bound, Observation, Proposal
from perfbound.workers.systems import load_system
from tests.fakes.finished import a_pair

PLAN = next(iter(plans(a_pair("rigorous"), load_system("test-function").spec).values()))


def made(number: int) -> ObservedTests:
    """Return tests whose J, which is maximised, goes up and down."""
    proposed = ProposedTests()
    found = ObservedTests(proposed)
    for k in range(number):
        proposed.add(ProposalFact("p", k, Proposal(k, (float(k), 0.0), None, None, None, None)))
        found.add(
            [ObservationFact("p", k, Observation((7.0 * k) % 11, ()), "")], BoundFact("p", k, Bound(1.0, 0.0, None))
        )
    return found


def test_all_of_few_tests_are_kept() -> None:
    found = observed_series(PLAN, made(9))
    assert found.test == tuple(range(9))
    assert found.y == tuple(0.0 - (7.0 * k) % 11 for k in range(9)), "the problem is a minimum"


@pytest.mark.parametrize("number", [101, 150, 5000])
def test_of_many_tests_the_worst_and_a_choice_of_the_others_are_kept(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    monkeypatch.setattr(observed, "MOST_TESTS", 100)
    found = observed_series(PLAN, made(number))
    assert 90 <= len(found.test) <= 100
    assert list(found.test) == sorted(set(found.test))
    assert (found.test[0], found.test[-1]) == (0, number - 1)
    assert set(worst_first(PLAN, made(number))[:50].tolist()) <= set(found.test)
    assert max(b - a for a, b in zip(found.test, found.test[1:], strict=False)) <= number / 20
    assert (
        len(found.x) == len(found.y) == len(found.distance) == len(found.lower) == len(found.upper) == len(found.test)
    )
