"""Whether the recheck repeated a rollout, and got the same."""

from pathlib import Path

import pytest

from perfbound.orchestrator.store.robustness import is_repeated
from perfbound.schemas.rollout import RolloutRequest
from tests.fakes.simulators import robustness, simulate

RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


@pytest.mark.parametrize("honest", [True, False])
def test_only_a_repetition_with_the_same_result_counts(tmp_path: Path, *, honest: bool) -> None:
    seen: list[str] = []

    def changing(request: RolloutRequest) -> float:
        seen.append(request.rollout)
        return 0.5 if honest else 0.5 + 0.001 * len(seen)

    assert simulate(tmp_path, robustness(RIGOROUS, spot_check=0, recheck=2, max_tests=6), changing, noisy=False)
    originals = [each for each in seen if not each.startswith("recheck")]
    repeated = [each for each in originals if is_repeated(tmp_path, each)]
    assert len(seen) - len(originals) == 2
    assert len(repeated) == (2 if honest else 0)
