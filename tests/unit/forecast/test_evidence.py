"""The bytes of the evidence that a campaign will take, beside what it takes."""

from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.campaign.series import Kept
from perfbound.orchestrator.forecast.evidence import evidence_bytes, kept_rollouts
from perfbound.orchestrator.run.display.so_far import size_of_evidence
from perfbound.workers.systems import load_system
from tests.unit.campaign.batches.test_batched_campaign import sampled

SPEC = load_system("test-function").spec


def a_plan(batch: int = 256, tests: int = 100_000, **changes: Any) -> Any:
    config = sampled(batch, tests, **changes)
    return config, plans(config, SPEC)["robustness"]


@pytest.mark.parametrize("batch", [16, 256, 1024])
@pytest.mark.parametrize("most", [10, 1000])
@pytest.mark.parametrize("tests", [5000, 100_000])
def test_about_so_many_are_kept_as_in_a_campaign_with_values_in_random_order(batch: int, most: int, tests: int) -> None:
    config, plan = a_plan(batch, tests, keep=f"worst {most}")
    rng, kept, window_at = np.random.default_rng(1), Kept(config.keep), plan.machine.window_at
    blocks = [rng.normal(size=min(batch, tests - first)) for first in range(0, tests, batch)]
    found = closed = 0
    for number in range(len(blocks) + 1):
        while closed < len(blocks) and (number == len(blocks) or closed <= number - window_at(number)):
            found += len(kept.places(closed, blocks[closed]) or [])
            kept.observe(closed, blocks[closed], 0)
            closed += 1
        kept.propose(number)
    assert found / 1.5 < kept_rollouts(config, plan, tests) < found * 1.5


def test_without_the_key_every_rollout_counts() -> None:
    config, plan = a_plan()
    assert evidence_bytes(config, plan, 100_000, 3000.0) == 3e8
    assert (
        size_of_evidence(config, {"robustness": plan}, 3000.0)
        == "evidence: 3 kB a rollout, at most about 300 MB in all"
    )


def test_the_line_says_what_is_left_out() -> None:
    config, plan = a_plan(keep="failures")
    assert size_of_evidence(config, {"robustness": plan}, 3000.0).endswith("11.1 MB in all, beside the failures")
    config, plan = a_plan(keep="worst 10")
    assert size_of_evidence(config, {"robustness": plan}, 3000.0).endswith('MB in all, with keep = "worst 10"')


def test_what_is_left_of_a_rollout_is_never_more_than_its_file() -> None:
    config, plan = a_plan(keep="failures")
    assert evidence_bytes(config, plan, 100.0, 50.0) == 5000.0
