"""Seeds: a pure function of the campaign, different for different rollouts, constant across versions."""

import itertools
from dataclasses import replace

import pytest

from perfbound.orchestrator.campaign.seeds import first_node, rollout_seed
from perfbound.schemas.facts import Header
from perfbound.schemas.ids import RolloutId
from perfbound.workers.systems import load_system
from tests.campaigns import config

PROBLEMS = ("nominal_robustness", "sim_gap")
GOLDEN = {
    1: [6121951589640100, 7505485939480075, 1284382602483127],
    2: [4685279568859548, 4120374171100042, 3904387885288489],
}
GOLDEN_NODES = {1: [6, 415], 2: [356, 74]}


def header(**changes: object) -> Header:
    """Return the header of the paper's campaign."""
    return Header.new(config("segway-paper", **changes), load_system("segway").spec, {}, run="0" * 16)


PAPER = header()


@pytest.mark.parametrize("rules", [1, 2])
def test_every_rollout_has_its_own_seed_below_2_to_53(rules: int) -> None:
    ids = [RolloutId(*key) for key in itertools.product(PROBLEMS, range(50), ("nominal", "true"), range(3))]
    seeds = [rollout_seed(replace(PAPER, rules=rules), rollout) for rollout in ids]
    assert len(set(seeds)) == len(ids)
    assert all(0 <= seed < 2**53 for seed in seeds)


@pytest.mark.parametrize("rules", [1, 2])
def test_seeds_stay_what_they_were(rules: int) -> None:
    # A change here changes every certificate that anyone wants to reproduce.
    fixed = replace(PAPER, rules=rules, config_sha256="1234" * 16)
    seeds = [rollout_seed(fixed, RolloutId("sim_gap", test, "true", 0)) for test in range(3)]
    assert seeds == GOLDEN[rules]
    assert [first_node(fixed, name, 441) for name in PROBLEMS] == GOLDEN_NODES[rules]


@pytest.mark.parametrize("change", [{"seed": 2}, {"risk_weight": 0.3}, {"specification": "always (phi <= 0.8)"}])
def test_another_campaign_has_other_seeds(change: dict[str, object]) -> None:
    rollout = RolloutId("sim_gap", 0, "true", 0)
    assert rollout_seed(PAPER, rollout) != rollout_seed(header(**change), rollout)


@pytest.mark.parametrize("key", ["visual", "max_attempts", "hung_after", "deadline"])
def test_a_key_that_decides_no_number_changes_no_seed(key: str) -> None:
    value = {"visual": "none"}.get(key, 7)
    assert header(**{key: value}).config_sha256 == PAPER.config_sha256


def test_a_key_at_its_default_is_as_good_as_left_out() -> None:
    assert header(max_tests=2000, resolution=21).config_sha256 == header().config_sha256


def test_by_rules_1_the_seed_alone_decides() -> None:
    rollout, other = RolloutId("sim_gap", 0, "true", 0), header(risk_weight=0.3)
    assert rollout_seed(replace(PAPER, rules=1), rollout) == rollout_seed(replace(other, rules=1), rollout)


def test_first_nodes_are_spread_over_the_lattice() -> None:
    nodes = [first_node(header(seed=seed), "sim_gap", 10) for seed in range(400)]
    assert all(20 <= nodes.count(node) <= 65 for node in range(10))  # 40 expected, sd 6
