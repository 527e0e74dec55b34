"""A search over starts and disturbances: what it finds, what enters its claims, and that all of it is verified."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import perfbound as pb
from perfbound.orchestrator.campaign.closing import importance
from perfbound.orchestrator.campaign.starts import Draws
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.refutation_text import counterexample_parts
from perfbound.orchestrator.mathematics.bounds.one_law.failures import beta_mixture_upper
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.facts import read_facts
from perfbound.orchestrator.store.read import read_header, reading
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import IMPORTANCE, SHRINK
from perfbound.schemas.result.certificate import Predicate
from perfbound.schemas.result.facts import BoundFact, ProposalFact, RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import certificates, robustness, simulate, spec, verified

WINDY = spec(noisy=True).model_copy(
    update={
        "disturbances": (
            pb.Normal(1, 2).named("gust", "m/s"),
            pb.LogNormal(1, 0.1).named("drag", ""),
            pb.Choice([0, 1], [0.9, 0.1]).named("wet", ""),
        ),
        "residual": False,
    }
)


FEW = {"over": "disturbances", "importance_tests": 60}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def a_campaign(**changes: Any) -> CampaignConfig:
    found = {"clip": [-5.0, 5.0], "max_tests": 200, "recheck": 3, "falsify": {"over": "disturbances"}, "spot_check": 0}
    return robustness({"method": "sample"}, **found | changes)


def corner(request: RolloutRequest) -> float:
    """Fail where gust and drag are above 2.2 and 2 sd and the start is near an edge: one rollout in 10,000 there."""
    gust, drag, _ = request.disturbances
    return max(0.8 - request.x[0], 2.2 - (gust - 1) / 2, (1.2214 - drag) / 0.12214)


def predicate(directory: Path) -> Predicate:
    found = files.read(directory)
    assert found is not None
    return found.predicate


def test_the_likeliest_failure_is_found_and_everything_follows_from_the_evidence(tmp_path: Path) -> None:
    simulate(tmp_path, a_campaign(), corner, noisy=True, system=WINDY)
    found = predicate(tmp_path)
    first = found.counterexample
    assert first is not None
    assert first.likeliest is not None
    exact = (2.2**2 + 2.0**2) ** 0.5
    assert exact <= first.likeliest.distance <= exact + 0.1
    assert first.likeliest.start["gust"] == pytest.approx(2.2, abs=0.05)
    assert first.likeliest.disturbances["gust"].value == pytest.approx(1 + 2 * first.likeliest.start["gust"], abs=1e-6)
    assert first.likeliest.rollouts <= 100
    sampled = first.likeliest.at_start
    assert sampled is not None
    probability = float(norm.sf(2.2) * norm.sf(2.0))
    assert 0.3 * probability < sampled.bound < probability
    assert (sampled.rollouts, sampled.share) == (200, 0.1)
    assert 20 < sampled.failures < 100
    assert first.disturbances.keys() == first.likeliest.disturbances.keys() == {"gust", "drag", "wet"}
    assert says(
        "; ".join(counterexample_parts(first, "")), "the likeliest failure of further rollouts is sd from the medians"
    )
    assert says(repr(pb.open(tmp_path)), "VERDICT VIOLATED COUNTEREXAMPLE likeliest failure probability at least CLAIM")
    (problem,) = Collector(tmp_path).refresh().problems
    assert problem.stopped_by == "counterexample"
    assert not verified(tmp_path)


def test_the_budget_ends_it_with_the_likeliest_so_far(tmp_path: Path) -> None:
    sought = {"over": "disturbances", "likeliest_tests": 4, "importance_tests": 1}
    simulate(tmp_path, a_campaign(falsify=sought), corner, noisy=True, system=WINDY)
    first = predicate(tmp_path).counterexample
    assert first is not None
    assert first.likeliest is not None
    assert first.likeliest.rollouts == 4
    with reading(tmp_path) as connection:
        bounds = [fact for fact in read_facts(connection) if isinstance(fact, BoundFact)]
    assert [fact.budget for fact in bounds if fact.problem == SHRINK] == [False, False, False, True]


def test_rollouts_around_the_failure_are_drawn_at_its_start_alone(tmp_path: Path) -> None:
    sought = {"over": "disturbances", "importance_tests": 100}
    simulate(tmp_path, a_campaign(falsify=sought), corner, noisy=True, system=WINDY)
    first = predicate(tmp_path).counterexample
    assert first is not None
    assert first.likeliest is not None
    with reading(tmp_path) as connection:
        facts = list(read_facts(connection))
    starts = [fact.proposal.x for fact in facts if isinstance(fact, ProposalFact) and fact.problem == IMPORTANCE]
    centre = tuple(first.likeliest.start[name] for name in ("z1", "z2", "gust", "drag", "wet"))
    assert len(starts) == 100
    assert {start[:2] for start in starts} == {centre[:2]}
    # Nine in ten around the failure: their mean says so, and one in ten has the median 0.
    assert np.mean([start[2] for start in starts]) == pytest.approx(0.9 * centre[2], abs=0.5)
    assert sum(start[2] < centre[2] - 2.0 for start in starts) in range(2, 20)
    assert {start[4] for start in starts} == {0.0, 1.0}, "choices follow their law"
    seeds = [fact.seed for fact in facts if isinstance(fact, RolloutFact) and fact.rollout.problem == IMPORTANCE]
    assert len(set(seeds)) == 100


def test_scores_beyond_the_reach_count_for_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many draws are one start there, whose weight would be that of none of them."""
    monkeypatch.setattr(importance, "REACH", 2.3)
    simulate(tmp_path, a_campaign(falsify=FEW), corner, noisy=True, system=WINDY)
    first = predicate(tmp_path).counterexample
    assert first is not None
    assert first.likeliest is not None
    assert first.likeliest.at_start is not None
    assert first.likeliest.at_start.failures > 10
    within = (norm.cdf(2.3) - norm.cdf(2.2)) * (norm.cdf(2.3) - norm.cdf(2.0))
    assert first.likeliest.at_start.bound <= within


def test_short_seeds_serve_them_as_well(tmp_path: Path) -> None:
    short = WINDY.model_copy(update={"seed_bits": 32})
    simulate(tmp_path, a_campaign(falsify=FEW), corner, noisy=True, system=short)
    first = predicate(tmp_path).counterexample
    assert first is not None
    assert first.likeliest is not None
    assert first.likeliest.at_start is not None
    assert first.likeliest.at_start.rollouts == 60
    assert not verified(tmp_path)


@pytest.mark.parametrize("tests", ["importance_tests", "likeliest_tests"])
def test_a_campaign_without_them_bounds_no_probability(tmp_path: Path, tests: str) -> None:
    simulate(tmp_path, a_campaign(falsify={"over": "disturbances", tests: 0}), corner, noisy=True, system=WINDY)
    first = predicate(tmp_path).counterexample
    assert first is not None
    assert first.likeliest is None or first.likeliest.at_start is None
    assert says("; ".join(counterexample_parts(first, "")), "violates the specification")
    assert "probability" not in "; ".join(counterexample_parts(first, ""))


def test_only_drawn_tests_are_evidence_and_their_disturbances_follow_their_laws(tmp_path: Path) -> None:
    simulate(tmp_path, a_campaign(max_tests=40), lambda _: 1.0, noisy=True, system=WINDY)
    found = predicate(tmp_path)
    assert found.counterexample is None
    assert found.claims[0].bound == pytest.approx(beta_mixture_upper(0, 10, 0.05), abs=2e-9), "one of four tests"
    with reading(tmp_path) as connection:
        header = read_header(connection, tmp_path)
        proposals = [fact for fact in read_facts(connection) if isinstance(fact, ProposalFact)]
    draws = Draws(header, "robustness")
    for number, fact in enumerate(fact for fact in proposals if (fact.test + 1) % 4 == 0):
        assert fact.proposal.x == draws.start(number)
    many = [draws.start(number) for number in range(2000)]
    gusts = [start[2] for start in many]
    assert sum(gusts) / 2000 == pytest.approx(0.0, abs=0.08)
    assert sum(each * each for each in gusts) / 2000 == pytest.approx(1.0, abs=0.12)
    assert sum(start[4] for start in many) / 2000 == pytest.approx(0.1, abs=0.025)
    assert not verified(tmp_path)


@pytest.mark.rest
def test_workers_and_stops_change_no_byte(tmp_path: Path) -> None:
    assert len(certificates(tmp_path, a_campaign(falsify=FEW), corner, noisy=True, cut_after=100, system=WINDY)) == 1


@pytest.mark.parametrize(("place", "key"), [((), "distance"), (("at_start",), "bound")])
def test_a_forged_number_is_found(tmp_path: Path, place: tuple[str, ...], key: str) -> None:
    simulate(tmp_path, a_campaign(falsify=FEW), corner, noisy=True, system=WINDY)
    path = tmp_path / files.CERTIFICATE
    found = json.loads(path.read_text())
    forged = found["predicate"]["counterexample"]["likeliest"]
    for each in place:
        forged = forged[each]
    forged[key] += 1e-6
    path.write_text(json.dumps(found, sort_keys=True, indent=1) + "\n")
    assert verified(tmp_path) == ["problems"]


@pytest.mark.parametrize(
    ("problem", "changes", "line"),
    [
        (
            {"method": "scenario", "alpha": 0.1},
            {"space": {"scenarios": [[0.0, 0.0]]}},
            "falsify.over: not for method 'scenario', whose bound takes every test of a search",
        ),
        ({"method": "sample"}, {"replicates": 2}, "falsify.over: each test has its own disturbances"),
        ({"method": "sample"}, {"space": {"table": [[0.0, 0.0]]}}, "falsify.over: a table of starts has no dist"),
        (
            {"method": "sample"},
            {"falsify": {"over": "disturbances", "shrink": True}},
            "shrink: not together with over",
        ),
    ],
)
def test_keys_that_do_not_go_together(problem: dict[str, Any], changes: dict[str, Any], line: str) -> None:
    found = {"clip": [-5.0, 5.0], "falsify": {"over": "disturbances"}} | changes
    with pytest.raises(ValueError, match=line):
        robustness(problem, **found)


def test_a_system_without_disturbances_has_none_to_search() -> None:
    with pytest.raises(CampaignError, match=r"falsify\.over: no variant of any-function that is simulated here has"):
        check_against(a_campaign(), spec(noisy=True), "file")
