"""Seeds: a pure function of the campaign, different for different rollouts, constant across versions."""

import itertools
from dataclasses import replace
from typing import Any

import pytest

from perfbound.orchestrator.campaign.seeds import first_node, rollout_seed, rollout_seeds, uniform
from perfbound.schemas.batch import batch_rollouts
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.facts import Header
from perfbound.workers.systems import load_system
from tests.campaigns import config

PROBLEMS = ("nominal_robustness", "sim_gap")
GOLDEN = [4685279568859548, 4120374171100042, 3904387885288489]
SHORT = [3555178937, 1209646203, 631762417]
GOLDEN_NODES = [356, 74]


def header(**changes: object) -> Header:
    """Return the header of the paper's campaign."""
    return Header.new(config("segway-paper", **changes), UNDECLARED, {}, run="0" * 16)


SEGWAY = load_system("segway").spec
UNDECLARED = SEGWAY.model_copy(update={"disturbances": (), "residual": True})
PAPER = header()


def test_every_rollout_has_its_own_seed_below_2_to_53() -> None:
    ids = [RolloutId(*key) for key in itertools.product(PROBLEMS, range(50), ("nominal", "true"), range(3))]
    seeds = [rollout_seed(PAPER, rollout) for rollout in ids]
    assert len(set(seeds)) == len(ids)
    assert all(0 <= seed < 2**53 for seed in seeds)


def test_seeds_stay_what_they_were() -> None:
    # A change here changes every certificate that anyone wants to reproduce.
    fixed = replace(PAPER, config_sha256="1234" * 16)
    seeds = [rollout_seed(fixed, RolloutId("sim_gap", test, "true", 0)) for test in range(3)]
    assert seeds == GOLDEN
    assert [first_node(fixed, name, 441) for name in PROBLEMS] == GOLDEN_NODES


@pytest.mark.parametrize("bits", [53, 32])
def test_both_variants_of_a_pair_share_the_seed_of_declared_disturbances(bits: int) -> None:
    declared = replace(PAPER, spec=SEGWAY.model_copy(update={"seed_bits": bits}))
    for test in range(20):
        nominal, true = (RolloutId("sim_gap", test, variant, 0) for variant in ("nominal", "true"))
        assert rollout_seed(declared, nominal) == rollout_seed(declared, true)
        assert rollout_seeds(declared, true, 2, 1)[0] == rollout_seed(declared, true)
        others = replace(declared, spec=UNDECLARED.model_copy(update={"seed_bits": bits}))
        assert rollout_seed(others, nominal) != rollout_seed(others, true)
    assert len({rollout_seed(declared, RolloutId("sim_gap", test, "true", 0)) for test in range(50)}) == 50


def short(bits: int = 32, **changes: Any) -> Header:
    """Return the header of a campaign on a system whose seeds have so many bits."""
    found = header(**changes)
    return replace(found, spec=found.spec.model_copy(update={"seed_bits": bits}))


@pytest.mark.rest
def test_short_seeds_differ_within_a_campaign() -> None:
    # So many that three pairs of drawn ones would be equal, in all problems and the spot check.
    campaign = short(31, replicates=10, max_tests=1900)
    places = itertools.product((*PROBLEMS, "spot_check"), range(1900), ("nominal", "true"), range(10))
    seeds = {rollout_seed(campaign, RolloutId(*key)) for key in places}
    assert len(seeds) == 114_000


@pytest.mark.parametrize("bits", [31, 32, 40, 52])
def test_short_seeds_fit(bits: int) -> None:
    campaign = short(bits)
    seeds = [rollout_seed(campaign, RolloutId("sim_gap", test, "true", 0)) for test in range(200)]
    assert 2**bits * 0.9 < max(seeds) < 2**bits


def test_short_seeds_of_a_test_differ_in_a_campaign_that_has_more_rollouts_than_seeds() -> None:
    large = short(31, replicates=100_000, max_tests=1_000_000)
    seeds = {rollout_seed(large, RolloutId("sim_gap", 999_999, "true", each)) for each in range(0, 100_000, 7)}
    assert len(seeds) == 14_286


def test_short_seeds_look_drawn() -> None:
    """Every bit is set in half of the seeds of neighbouring rollouts, and differs between half of the neighbours."""
    campaign = short()
    seeds = [rollout_seed(campaign, RolloutId("sim_gap", test, "true", 0)) for test in range(2000)]
    changes = [one ^ other for one, other in itertools.pairwise(seeds)]
    for numbers in (seeds, changes):
        counts = [sum(number >> bit & 1 for number in numbers) for bit in range(32)]
        assert all(880 <= count <= 1120 for count in counts), counts  # 1000 expected, sd 22


def test_short_seeds_stay_what_they_were() -> None:
    fixed = replace(short(), config_sha256="1234" * 16)
    assert [rollout_seed(fixed, RolloutId("sim_gap", test, "true", 0)) for test in range(3)] == SHORT


@pytest.mark.parametrize("change", [{"seed": 2}, {"max_tests": 7}, {"replicates": 3}])
def test_another_campaign_has_other_short_seeds(change: dict[str, Any]) -> None:
    one, other = short(), short(**change)
    ids = [RolloutId("sim_gap", test, "true", 0) for test in range(100)]
    assert not {rollout_seed(one, each) for each in ids} & {rollout_seed(other, each) for each in ids}


@pytest.mark.parametrize("change", [{"seed": 2}, {"risk_weight": 0.3}, {"specification": "always (phi <= 0.8)"}])
def test_another_campaign_has_other_seeds(change: dict[str, object]) -> None:
    rollout = RolloutId("sim_gap", 0, "true", 0)
    assert rollout_seed(PAPER, rollout) != rollout_seed(header(**change), rollout)


@pytest.mark.parametrize("bits", [53, 32])
def test_campaigns_with_the_same_draws_have_the_same_starts_and_seeds(bits: int) -> None:
    one, other, third = (
        short(bits, draws=text * 64, specification=f"always (phi <= {limit})", seed=seed)
        for text, limit, seed in (("a", 0.8, 1), ("a", 0.9, 1), ("b", 0.8, 1))
    )
    rollout = RolloutId("sim_gap", 0, "true", 0)
    assert one.config_sha256 != other.config_sha256
    assert rollout_seed(one, rollout) == rollout_seed(other, rollout) != rollout_seed(third, rollout)
    assert rollout_seeds(one, rollout, 5, 2) == rollout_seeds(other, rollout, 5, 2)
    assert first_node(one, "sim_gap", 441) == first_node(other, "sim_gap", 441)
    assert (uniform(one, "sim_gap.starts", range(3), 2) == uniform(other, "sim_gap.starts", range(3), 2)).all()
    assert rollout_seed(short(bits, draws="a" * 64, seed=2), rollout) != rollout_seed(one, rollout)


@pytest.mark.parametrize("key", ["visual", "max_attempts", "hung_after", "deadline"])
def test_a_key_that_decides_no_number_changes_no_seed(key: str) -> None:
    value = {"visual": "none"}.get(key, 7)
    assert header(**{key: value}).config_sha256 == PAPER.config_sha256


def test_a_key_at_its_default_is_as_good_as_left_out() -> None:
    assert header(max_tests=2000, resolution=21).config_sha256 == header().config_sha256


def test_first_nodes_are_spread_over_the_lattice() -> None:
    nodes = [first_node(header(seed=seed), "sim_gap", 10) for seed in range(400)]
    assert all(20 <= nodes.count(node) <= 65 for node in range(10))  # 40 expected, sd 6


@pytest.mark.parametrize("seed_bits", [53, 32])
def test_a_rollout_of_a_batch_has_the_seed_that_it_has_alone(seed_bits: int) -> None:
    campaign = short(seed_bits)
    first = RolloutId("sim_gap", 1000, "true", 3)
    wanted = [rollout_seed(campaign, each) for each in batch_rollouts(first, 5, 4)]
    assert rollout_seeds(campaign, first, 5, 4) == wanted
