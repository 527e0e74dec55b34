"""How many bytes the trajectory files of a campaign take, from those of one rollout.

With `keep = "worst N"` a rollout keeps its samples if fewer than N of those before it are as bad: of n rollouts in
random order about N (1 + ln(n / N)) do, and more where others are in flight.
"""

import math

from ...schemas.file.config import CampaignConfig
from ...schemas.file.keys import most_kept
from ..campaign.plan import ProblemPlan

REDUCED, COORDINATE = 75, 18
"""Bytes of a rollout without its samples, and for each number of its start, in the file of a batch of 256."""


def evidence_bytes(config: CampaignConfig, plan: ProblemPlan, rollouts: float, size: float) -> float:
    """Return the bytes of the files of so many rollouts of a problem, whose own file has `size` bytes.

    With `keep = "failures"` those of the failures are left out, since nobody knows their number.
    """
    kept = kept_rollouts(config, plan, rollouts)
    return kept * size + (rollouts - kept) * min(size, REDUCED + COORDINATE * len(plan.parameters))


def kept_rollouts(config: CampaignConfig, plan: ProblemPlan, rollouts: float) -> float:
    """Return about how many of a problem's rollouts keep their samples, failures left out."""
    most, machine = most_kept(config.keep), plan.machine
    if most is None:
        return rollouts if config.keep == "all" else 0.0
    each = machine.block * len(plan.rollouts)
    found = 0.0
    for block in range(math.ceil(rollouts / each)):
        closed = max(0, block + 1 - machine.window_at(block)) * each
        found += each * min(most / max(closed, most), most / config.batch, 1.0)
    return min(rollouts, found)
