"""The random choices of a campaign: functions of its seed and of the choice alone, never of time or machine."""

import numpy as np

from ...schemas.campaign import CampaignConfig
from ...schemas.ids import RolloutId

VARIANTS = ("nominal", "true")


def rollout_seed(config: CampaignConfig, rollout: RolloutId) -> int:
    """Return the seed of a rollout, below 2^53; a retry uses the same one."""
    key = (problem_index(config, rollout.problem), rollout.test, VARIANTS.index(rollout.variant), rollout.replicate)
    state = np.random.SeedSequence(config.seed, spawn_key=key).generate_state(1, np.uint64)
    # 53 bits: every JSON reader keeps such a number exactly.
    return int(state[0] >> np.uint64(11))


def first_node(config: CampaignConfig, problem: str, size: int) -> int:
    """Return the lattice node of a problem's first test, uniform over `size` nodes."""
    sequence = np.random.SeedSequence(config.seed, spawn_key=(problem_index(config, problem),))
    return int(np.random.default_rng(sequence).integers(size))


def problem_index(config: CampaignConfig, problem: str) -> int:
    """Return the position of a problem in the campaign file."""
    return [each.name for each in config.problems].index(problem)  # type: ignore[arg-type]
