"""Seeds: a pure function of the campaign, different for different rollouts, constant across versions."""

import itertools

from perfbound.orchestrator.campaign.seeds import first_node, rollout_seed
from perfbound.schemas.ids import RolloutId
from tests.campaigns import config

PAPER = config("segway-paper")
GOLDEN = [6121951589640100, 7505485939480075, 1284382602483127]
GOLDEN_NODES = [6, 415]


def test_every_rollout_has_its_own_seed_below_2_to_53() -> None:
    variants, problems = ("nominal", "true"), ("nominal_robustness", "sim_gap")
    ids = [RolloutId(*key) for key in itertools.product(problems, range(50), variants, range(3))]
    seeds = [rollout_seed(PAPER, rollout) for rollout in ids]
    assert len(set(seeds)) == len(ids)
    assert all(0 <= seed < 2**53 for seed in seeds)


def test_seeds_stay_what_they_were() -> None:
    # A change here changes every certificate that anyone wants to reproduce.
    seeds = [rollout_seed(PAPER, RolloutId("sim_gap", test, "true", 0)) for test in range(3)]
    assert seeds == GOLDEN
    assert [first_node(PAPER, name, 441) for name in ("nominal_robustness", "sim_gap")] == GOLDEN_NODES


def test_another_campaign_seed_gives_other_seeds() -> None:
    other = config("segway-paper", seed=2)
    rollout = RolloutId("sim_gap", 0, "true", 0)
    assert rollout_seed(PAPER, rollout) != rollout_seed(other, rollout)


def test_first_nodes_are_spread_over_the_lattice() -> None:
    nodes = [first_node(config("segway-paper", seed=seed), "sim_gap", 10) for seed in range(400)]
    assert all(20 <= nodes.count(node) <= 65 for node in range(10))  # 40 expected, sd 6
