"""Campaigns of method `sample`: what a file may ask, what is claimed, and what changes nothing."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from rich.console import Console

from perfbound.orchestrator.campaign.checks import check, check_new
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.mathematics.bounds.one_law.failures import beta_mixture_upper
from perfbound.orchestrator.mathematics.bounds.one_law.share import clopper_pearson_upper, quantile_rank
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.result.certificate import Certificate, CertificateClaim
from perfbound.schemas.result.facts import ProposalFact, RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts, says
from tests.fakes.simulators import certificates, noise, robustness, simulate, spec, verified

SAMPLE = {"method": "sample"}
CLIP = (-1.0, 1.0)
LEVELS: list[dict[str, Any]] = [
    {"quantity": "failure_probability"},
    {"quantity": "quantile", "level": 0.1},
    {"quantity": "cvar", "level": 0.1},
    {"quantity": "share_of_starts", "level": 0.1},
    {"quantity": "mean", "factor": 2.0},
    {"quantity": "risk"},
    {"quantity": "next_rollout", "level": 0.05},
]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def shaky(request: RolloutRequest) -> float:
    return 0.6 - 0.5 * request.x[0] + 0.2 * noise(request.seed)


def plane(request: RolloutRequest) -> float:
    return 0.7 - 0.5 * request.x[0] - 0.3 * request.x[1]


def sampled(**changes: Any) -> CampaignConfig:
    """Return a campaign of 60 samples on the unit square."""
    return robustness(
        {**SAMPLE, **changes.pop("problem", {})}, **{"max_tests": 60, "clip": CLIP, "recheck": 3} | changes
    )


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


def claims(directory: Path) -> tuple[CertificateClaim, ...]:
    return certificate(directory).predicate.claims


def values(directory: Path) -> list[float]:
    """Return the robustness of every rollout in test order."""
    with read.reading(directory) as connection:
        facts = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, RolloutFact)]
    own = [fact for fact in facts if fact.rollout.problem == "robustness"]
    return [fact.robustness or 0.0 for fact in sorted(own, key=lambda fact: fact.rollout)]


def starts(directory: Path) -> list[tuple[float, ...]]:
    with read.reading(directory) as connection:
        facts = recorded_facts.read_facts(connection)
        return [fact.proposal.x for fact in facts if isinstance(fact, ProposalFact) and fact.problem == "robustness"]


# What is claimed


def test_the_claims_are_those_of_the_file_in_their_order(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(claims=LEVELS), shaky, noisy=True)
    found = claims(tmp_path)
    observed = values(tmp_path)
    rank = quantile_rank(60, 0.1, 0.05)
    assert rank is not None
    assert [each.quantity for each in found] == [each["quantity"] for each in LEVELS]
    assert found[0].bound == clopper_pearson_upper(sum(value < 0 for value in observed), 60, 0.05)
    assert found[0].samples == 60
    assert found[1].bound == pytest.approx(sorted(observed)[rank - 1], abs=1e-8)
    assert [each.level for each in found] == [None, 0.1, 0.1, 0.1, None, None, 0.05]
    assert [each.factor for each in found] == [None, None, None, None, 2.0, None, None]
    assert [each.probability for each in found] == [0.95] * 6 + [0.95]
    assert [each.samples for each in found] == [60, 60, None, None, None, None, 60]
    assert [each.sense for each in found] == ["<="] + [">="] * 6
    result = certificate(tmp_path).predicate.problems[0]
    assert (result.bound, result.sense, result.tests) == (found[0].bound, "max", 60)
    assert certificate(tmp_path).predicate.spot_check is None
    assert not verified(tmp_path)


def test_of_a_deterministic_system_most_starts_keep_a_value_and_not_a_mean(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(claims=LEVELS[3:4], clip=None), plane, noisy=False)
    (found,) = claims(tmp_path)
    rank = quantile_rank(60, 0.1, 0.05)
    assert rank is not None
    assert found.bound == pytest.approx(sorted(values(tmp_path))[rank - 1], abs=1e-8)
    assert found.subject == "robustness on all starts but 10 %"


def test_without_claims_it_is_the_failure_probability(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(), shaky, noisy=True)
    assert [each.quantity for each in claims(tmp_path)] == ["failure_probability"]


def test_jointly_each_claim_has_its_part_of_delta(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(claims=LEVELS[:2], problem={"jointly": True, "delta": 0.1}), shaky, noisy=True)
    assert [each.probability for each in claims(tmp_path)] == [0.95, 0.95]
    console = Console(record=True, width=300)
    print_certificate(certificate(tmp_path), console)
    assert says(console.export_text(), "2 least 0.9000.")


def test_a_stop_that_looks_at_outcomes_has_betting_bounds(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(until_counterexample=True, claims=LEVELS[:2]), shaky, noisy=True)
    found, count = certificate(tmp_path).predicate, len(values(tmp_path)) - 0
    assert found.counterexample is not None
    tests = found.problems[0].tests
    assert found.counterexample.test == tests - 1 < 59
    assert found.claims[0].bound == pytest.approx(
        min(beta_mixture_upper(int(n == tests), n, 0.05) for n in range(1, tests + 1)), abs=2e-9
    )
    assert found.claims[0].samples is None
    assert count >= tests
    assert not verified(tmp_path)


def test_a_stop_that_may_look_at_outcomes_has_betting_bounds_at_its_budget_too(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(until_counterexample=True), lambda _: 0.5, noisy=True)
    (found,) = claims(tmp_path)
    assert (found.samples, found.bound) == (None, beta_mixture_upper(0, 60, 0.05))


def test_six_parameters_are_no_more_than_two(tmp_path: Path) -> None:
    table = {"table": [[0.1, 0.9], [0.5, 0.5], [0.5, 0.5]]}
    simulate(tmp_path, sampled(space=table), shaky, noisy=True)
    drawn = starts(tmp_path)
    assert set(drawn) == {(0.1, 0.9), (0.5, 0.5)}
    assert drawn.count((0.5, 0.5)) > drawn.count((0.1, 0.9))


# Several requirements

TWO = [{"name": "low", "formula": "value >= 0", "id": "R-1"}, {"name": "high", "formula": "value <= 0.8"}]


def several(**changes: Any) -> CampaignConfig:
    return sampled(**{"specification": None, "specifications": TWO, **changes})


def test_each_requirement_has_its_claim_after_that_of_the_whole(tmp_path: Path) -> None:
    simulate(tmp_path, several(claims=LEVELS[:2], replicates=2), shaky, noisy=True)
    found = claims(tmp_path)
    assert [(each.quantity, each.requirement) for each in found] == [
        (quantity, name) for quantity in ("failure_probability", "quantile") for name in (None, "low", "high")
    ]
    assert says(str(found[1].subject), "probability violates low")
    assert says(str(found[5].subject), "10 % high")
    assert certificate(tmp_path).predicate.question["specifications"] == TWO
    whole, low, high = (each.bound for each in found[:3])
    assert max(low, high) <= whole <= 1.0
    assert min(found[4].bound, found[5].bound) >= found[3].bound
    assert not verified(tmp_path)


def test_the_claims_of_a_requirement_are_those_of_its_robustness(tmp_path: Path) -> None:
    simulate(tmp_path, several(claims=LEVELS[1:2]), shaky, noisy=True)
    rank = quantile_rank(60, 0.1, 0.05)
    assert rank is not None
    history = recorded_facts.history(tmp_path)["robustness"]
    for place, claim in enumerate(claims(tmp_path)):
        robust = sorted(test.observation.each[place] for test in history)
        assert claim.bound == pytest.approx(robust[rank - 1], abs=1e-8)
    assert all(test.observation.each[0] == min(test.observation.each[1:]) for test in history)
    assert [test.observation.each[0] for test in history] == values(tmp_path)


def test_jointly_counts_the_requirements() -> None:
    config = several(problem={"jointly": True, "delta": 0.06})
    assert [each.delta for each in config.claims_of(config.problems[0])] == [0.02] * 3


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"specification": "value > 0"}, "specification:"),
        ({"specifications": [{"name": "1st", "formula": "value > 0"}]}, "pattern"),
    ],
)
def test_requirements_that_cannot_be(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError, match=facts(reason)):
        several(**changes)


def test_an_error_names_the_requirement() -> None:
    wrong = [{"name": "first", "formula": "value > 0"}, {"name": "second", "formula": "speed > 0"}]
    with pytest.raises(CampaignError, match=r"c\.toml: specifications\.second: .*speed"):
        check(several(specifications=wrong), spec(noisy=True), "c.toml")


def test_requirements_are_texts_or_tables() -> None:
    text = """horizon = 5
system.name = "cars"
[space]
gap = [5, 60]
[specifications]
gap = "always (distance > 0)"
stop = { formula = "eventually (speed < 1)", id = "REQ-7", text = "The car stops.", link = "docs/req.md" }
"""
    found = parse_campaign(text.encode(), "cars.toml")
    assert found.formula == "(always (distance > 0)) and (eventually (speed < 1))"
    assert [each.id for each in found.specifications] == [None, "REQ-7"]
    assert [problem.method for problem in found.problems] == ["sample"]
    assert parse_campaign(text.replace('"REQ-7"', '"REQ-8"').encode(), "cars.toml").digest != found.digest


@pytest.mark.parametrize("given", ["[1, 2]", '[{ formula = "distance > 0" }]', '["x"]', "[[1, 2]]", "3"])
def test_requirements_that_are_none_are_one_line(given: str) -> None:
    text = f'horizon = 5\nsystem.name = "cars"\nspace.gap = [5, 60]\nspecifications = {given}\n'
    with pytest.raises(CampaignError, match=r"c\.toml: specifications") as caught:
        parse_campaign(text.encode(), "c.toml")
    assert not any("\n" in line for line in caught.value.lines)


def test_a_step_that_is_far_too_small_is_refused() -> None:
    space = "space.w = { low = 0, high = 1e300, step = 1e-300 }"
    text = f'horizon = 5\nspecification = "v > 0"\nsystem.name = "cars"\n{space}\n'
    with pytest.raises(CampaignError, match=r"space\.w\.step: 1e-300 is not allowed"):
        parse_campaign(text.encode(), "c.toml")


def test_a_clip_beyond_every_number_is_refused() -> None:
    with pytest.raises(CampaignError, match=r"clip: .* is beyond 1e\+100"):
        check_new(sampled(clip=(-1e308, 1e308)), spec(noisy=True), "c.toml")


def test_a_fault_in_a_requirement_names_it() -> None:
    text = 'horizon = 5\nsystem.name = "cars"\nspace.gap = [5, 60]\n[specifications]\nfirst = "gap > 0"\nsecond = 3\n'
    with pytest.raises(CampaignError, match=facts("c.toml: specifications.second.formula: 3")):
        parse_campaign(text.encode(), "c.toml")


# What changes nothing


@pytest.mark.rest
def test_workers_and_a_stop_in_between_change_no_byte(tmp_path: Path) -> None:
    config = sampled(claims=LEVELS)
    assert len(certificates(tmp_path, config, shaky, noisy=True, cut_after=25)) == 1


def test_claims_are_part_of_the_identity_and_their_absence_is_not() -> None:
    assert sampled().digest != sampled(claims=LEVELS[:2]).digest
    assert "claims" not in sampled().model_dump_json()


@pytest.mark.rest
def test_a_drifting_simulator_refutes_the_one_law(tmp_path: Path) -> None:
    count = 0

    def drifting(request: RolloutRequest) -> float:
        nonlocal count
        count += 1
        return min(0.1 * noise(request.seed) + 0.002 * count, 1.0)

    simulate(tmp_path, sampled(max_tests=300, recheck=0), drifting, noisy=True, workers=1)
    (found,) = claims(tmp_path)
    assert "one_law_per_start/robustness" in found.refuted


@pytest.mark.rest
def test_the_report_shows_the_robustness_and_the_bounds(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(claims=LEVELS), shaky, noisy=True)
    (problem,) = Collector(tmp_path).refresh().problems
    assert problem.drawn is not None
    observed = values(tmp_path)
    assert sum(problem.drawn.counts) == 60
    assert problem.drawn.violations == sum(value < 0 for value in observed)
    negative = sum(n for n, right in zip(problem.drawn.counts, problem.drawn.edges[1:], strict=True) if right <= 0)
    assert negative == problem.drawn.violations
    assert [mark.name for mark in problem.drawn.marks] == [
        "quantile 10 %",
        "cvar 10 %",
        "share of starts 10 %",
        "mean, factor 2",
        "risk",
        "next rollout 5 %",
    ]
    assert problem.tests.y == tuple(pytest.approx(value) for value in observed)
    assert problem.alpha is None


def test_a_counterexample_at_the_first_sample_of_a_noisy_system_is_certified(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(until_counterexample=True), lambda _: -0.5, noisy=True)
    assert claims(tmp_path)[0].bound == 1.0
    assert verified(tmp_path) == []


def test_values_of_exactly_0_count_as_violations(tmp_path: Path) -> None:
    # A distance that ends at contact has the robustness 0 of `distance > 0`.
    simulate(tmp_path, sampled(specification="value > 0"), lambda each: max(each.x[0] - 0.3, 0.0), noisy=False)
    (found,) = claims(tmp_path)
    zeros = sum(value == 0 for value in values(tmp_path))
    assert 5 < zeros < 40
    assert found.bound == clopper_pearson_upper(zeros, 60, 0.05)
    drawn = next(each for each in certificate(tmp_path).predicate.assumptions if each.id.startswith("drawn_starts/"))
    assert f"{zeros} values are exactly 0" in drawn.detail
    assert not verified(tmp_path)


def test_a_bound_at_the_lower_clip_says_that_it_is_about_clipped_values(tmp_path: Path) -> None:
    asked = [{"quantity": "quantile", "level": 0.1}, {"quantity": "next_rollout", "level": 0.05}]
    simulate(tmp_path, sampled(claims=asked), lambda _: -5.0, noisy=False)
    for found in claims(tmp_path):
        assert found.bound == -1.0
        assert found.subject is not None
        assert found.subject.endswith(", clipped to [-1, 1]")


def test_a_delta_that_is_next_to_nothing_is_no_certainty(tmp_path: Path) -> None:
    simulate(tmp_path, sampled(problem={"delta": 1e-17}), shaky, noisy=True)
    assert claims(tmp_path)[0].probability == 0.999999999


# What a file may ask


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"claims": [{"quantity": "quantile"}]}, "level: required by 'quantile'"),
        ({"claims": [{"quantity": "mean", "level": 0.1}]}, "level: 'quantile' 'cvar' 'share_of_starts'"),
        ({"claims": [{"quantity": "risk", "factor": 2.0}]}, "factor: no bound of 'risk'"),
        ({"claims": [{"quantity": "next_rollout", "level": 0.1, "delta": 0.1}]}, "delta: the level of 'next_rollout'"),
        (
            {"claims": [{"quantity": "quantile", "level": 0.01}]},
            "max_tests: claims.0 least 299 60",
        ),
        ({"claims": [{"quantity": "next_rollout", "level": 0.01}]}, "max_tests: claims.0 least 99"),
        ({"claims": [LEVELS[0], LEVELS[0]]}, "claims.1: twice"),
        ({"clip": None, "claims": [{"quantity": "mean"}]}, "clip: required claims.0"),
        ({"clip": (0.0, 1.0)}, "clip: [0.0, 1.0] below 0"),
        (
            {"problem": {"jointly": True}, "claims": LEVELS[-1:]},
            "jointly: claims.0",
        ),
        ({"until_counterexample": True, "claims": LEVELS[-1:]}, "claims.0.quantity: 'next_rollout'"),
        (
            {"until_counterexample": True, "clip": None, "claims": LEVELS[1:2]},
            "clip: required claims.0 until_counterexample",
        ),
        ({"anytime": True, "claims": LEVELS[-1:]}, "claims.0.quantity: 'next_rollout' anytime"),
        ({"anytime": True, "clip": None, "claims": LEVELS[1:2]}, "clip: required claims.0 anytime"),
        ({"problem": {"resolution": 5}}, "resolution: 'sample'"),
        ({"problem": {"sense": "min"}}, "sense: has no meaning in method 'sample'"),
    ],
)
def test_what_cannot_be_claimed_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError, match=facts(reason)):
        sampled(**changes)


def test_claims_about_drawn_starts_need_a_method_that_draws() -> None:
    rigorous = {
        "method": "rigorous",
        "alpha": 0.1,
        "rkhs_norm": 1.0,
        "noise_scale": 0.1,
        "kernel": {"length_scale": 1.0},
    }
    with pytest.raises(ValidationError, match="claims: only method 'sample'"):
        robustness(rigorous, claims=LEVELS[:1], clip=CLIP)


def test_most_starts_of_a_noisy_system_need_a_clip(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match=facts("clip: required claims.0 mean")):
        simulate(tmp_path, sampled(clip=None, claims=LEVELS[3:4]), shaky, noisy=True)


@pytest.mark.parametrize(
    "space",
    [
        '[space]\ngap = { low = 5, high = 60, distribution = "normal", mean = 30, sd = 8 }',
        "[space]\ngap = { choices = [1, 2] }",
        "[space]\ntable = [[1.0], [2.0]]",
        '[space]\ngap = [5, 60]\n[[claims]]\nquantity = "failure_probability"',
    ],
)
def test_a_file_that_draws_needs_no_method_and_twelve_lines(space: str) -> None:
    text = f'specification = "always(distance > 0)"\nhorizon = 5\nsystem.name = "cars"\n{space}\n'
    assert len(text.splitlines()) <= 12
    found = parse_campaign(text.encode(), "braking.toml")
    assert [problem.method for problem in found.problems] == ["sample"]
    assert [each.asked.quantity for each in found.claims_of(found.problems[0])] == ["failure_probability"]
