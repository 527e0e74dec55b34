"""False alarms of the test for jumps, on continuous functions with noise of several laws, and its power on jumps."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from perfbound.orchestrator.prepare.calibrate import pilot as calibration_pilot
from perfbound.orchestrator.prepare.calibrate.pilot import CalibrationPilot
from perfbound.orchestrator.prepare.calibrate.rollouts import RolloutBatch, StartRollout
from tests.studies.coverage.calibration import FunctionRollouts, draft, spec
from tests.studies.coverage.functions import Floats, Function
from tests.studies.coverage.spot_checks import FAMILIES, LEVEL, OBSERVED, SD

FUNCTIONS = 60
Law = Callable[[np.random.Generator, Floats], Floats]
LAWS: dict[str, Law] = {
    "Gaussian": lambda rng, z: SD * rng.standard_normal(len(z)),
    "heavy tails": lambda rng, z: SD / 3.0**0.5 * np.asarray(rng.standard_t(3, len(z)), dtype=np.float64),
    "skewed": lambda rng, z: -SD * (rng.exponential(1.0, len(z)) - 1.0),
    "different from start to start": lambda rng, z: (
        SD * (0.2 + 2.0 * (z[:, 0] / 5.0) ** 2) * rng.standard_normal(len(z))
    ),
    "rare falls": lambda rng, z: np.where(rng.random(len(z)) < 0.04, -5.0 * SD, 0.0),
}


class NoisyRollouts(FunctionRollouts):
    """Rollouts of one function with noise of any law."""

    def __init__(self, rng: np.random.Generator, function: Function, law: Law) -> None:
        super().__init__(rng, function, OBSERVED[1])
        self._law = law

    def simulate(self, wanted: Sequence[StartRollout]) -> RolloutBatch:
        """Draw the robustness of every rollout."""
        z = np.array([each.start for each in wanted])
        values = self._function(z) + self._law(self._rng, z)
        numbers = [(each.test, each.replicate) for each in wanted]
        self._batches.append(dict(zip(numbers, values.tolist(), strict=True)))
        self.count += len(wanted)
        return RolloutBatch(len(self._batches))


def found_jumps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, family: str, law: Law) -> tuple[int, int]:
    """Return of how many functions a jump is suspected, and found."""
    # No kernel decides on a jump, and to fit one takes most of the time.
    monkeypatch.setattr(calibration_pilot, "calibrated", lambda measured, *_: measured)
    monkeypatch.setattr(calibration_pilot, "least_predicted", lambda _: [])
    read, suspected, found = draft(tmp_path, noisy=True), 0, 0
    for number in range(FUNCTIONS):
        rng = np.random.default_rng((20261123, number))
        drawn = FAMILIES[family](rng)
        rollouts = NoisyRollouts(rng, lambda z, drawn=drawn: LEVEL + drawn(z), law)  # type: ignore[misc]
        pilot = CalibrationPilot(read, 0, spec(noisy=True), rollouts, propose_clip=False)
        descents = pilot.calibrated(400, number).descents  # type: ignore[attr-defined]
        suspected += any(each.is_suspected for each in descents)
        found += any(each.is_jump for each in descents)
    return suspected, found


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_a_continuous_function_has_no_jump_whatever_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, law: Law
) -> None:
    _, found = found_jumps(tmp_path, monkeypatch, "GP draws", law)
    assert found <= 3, "the quantile .99 of a binomial law with 60 functions and a rate of .01"


def test_noise_with_heavy_tails_is_suspected_and_a_jump_is_found_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suspected, _ = found_jumps(tmp_path, monkeypatch, "GP draws", LAWS["heavy tails"])
    assert suspected > 0.1 * FUNCTIONS, "or the fresh rollouts have nothing to decide"
    _, found = found_jumps(tmp_path, monkeypatch, "jumps", LAWS["heavy tails"])
    assert found >= 0.75 * FUNCTIONS, "jumps are .1 to 1.4 high, with a noise of .1"
