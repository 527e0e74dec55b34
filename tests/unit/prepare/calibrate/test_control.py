"""A calibration of a system with declared disturbances: its values are those that a control leaves."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.calibration.noise import pooled
from perfbound.orchestrator.mathematics.control.basis import normal_basis
from perfbound.orchestrator.prepare.calibrate.constants import ProblemCalibration
from perfbound.orchestrator.prepare.calibrate.control import PilotControl, PilotRollouts
from perfbound.orchestrator.prepare.calibrate.design import calibration_seed
from perfbound.orchestrator.prepare.calibrate.pilot import CalibrationPilot
from perfbound.orchestrator.prepare.calibrate.rollouts import RolloutBatch, StartRollout
from perfbound.schemas.file.disturbance import Normal
from tests.studies.coverage.calibration import FunctionRollouts, spec
from tests.studies.coverage.functions import Floats
from tests.studies.coverage.spot_checks import OBSERVED
from tests.unit.prepare.calibrate.test_constants import COARSE, read

SD, RESIDUAL = 0.2, 0.02


class DisturbedRollouts(FunctionRollouts):
    """Rollouts of one function with a disturbance, and noise that nobody declared."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng, lambda z: 1.0 + 0.5 * np.sin(z[:, 0] / 2) * np.cos(z[:, 1] / 3), OBSERVED[1])
        self._drawn: dict[tuple[int, int], float] = {}

    def simulate(self, wanted: Sequence[StartRollout]) -> RolloutBatch:
        """Draw the robustness of every rollout, from its disturbance."""
        places = [(each.test, each.replicate) for each in wanted]
        self._drawn |= dict(zip(places, self._rng.standard_normal(len(wanted)).tolist(), strict=True))
        z = np.array([each.start for each in wanted])
        values = self._function(z) + SD * self.scores(wanted)[:, 0] + RESIDUAL * self._rng.standard_normal(len(z))
        self._batches.append(dict(zip(places, values.tolist(), strict=True)))
        self.count += len(wanted)
        return RolloutBatch(len(self._batches))

    def scores(self, wanted: Sequence[StartRollout]) -> Floats:
        """Return those that were drawn."""
        return np.array([[self._drawn[each.test, each.replicate]] for each in wanted])


def calibration(tmp_path: Path, control: str) -> ProblemCalibration:
    system = spec(noisy=True).model_copy(update={"disturbances": (Normal(0, 2).named("gust", "m/s"),)})
    draft = read(tmp_path, f'method = "kriging"\ncontrol = "{control}"\n{COARSE}')
    pilot = CalibrationPilot(draft, 0, system, DisturbedRollouts(np.random.default_rng(1)), propose_clip=False)
    return pilot.calibrated(400, 1)


def test_constants_are_those_of_what_the_control_leaves(tmp_path: Path) -> None:
    found, without = (calibration(tmp_path, control) for control in ("on", "off"))
    assert pooled(found.measured.values) < 2 * RESIDUAL < SD / 2 < pooled(without.measured.values)
    assert np.array_equal(found.measured.plain, without.measured.values)
    # Fresh rollouts later on lose their noise as well.
    assert float(found.measured.at_noisiest.std(axis=1).max()) < 2 * RESIDUAL
    assert found.keys["spread"] > SD / 2, "until its first fit a campaign has no control"  # type: ignore[operator]
    trials = found.choice.chosen, without.choice.chosen
    assert trials[0] is not None
    assert trials[1] is not None
    assert trials[0].width < 0.5 * trials[1].width
    assert 0.95 < found.measured.explained < 1.0


def test_a_control_explains_no_noise_of_rollouts_that_it_was_fitted_on() -> None:
    rng = np.random.default_rng(2)
    first = PilotRollouts(rng.random((64, 2)), rng.standard_normal((64, 2, 3)), 0.1 * rng.standard_normal((64, 2)))
    control = PilotControl.of([normal_basis()] * 3, (-1.0, 1.0), first)
    assert pooled(first.values - control.of_first(first)) > 0.97 * pooled(first.values)


@pytest.mark.parametrize("place", [0, 1])
def test_each_half_is_explained_by_the_other(place: int) -> None:
    rng = np.random.default_rng(3)
    scores = rng.standard_normal((40, 2, 1))
    values = 0.1 * scores[:, :, 0]
    values[place::2] = 0.1 * rng.standard_normal((20, 2))  # nothing is to be learnt from this half
    first = PilotRollouts(rng.random((40, 2)), scores, values)
    left = values - PilotControl.of([normal_basis()], (-1.0, 1.0), first).of_first(first)
    other = 1 - place
    assert pooled(left[other::2]) > 0.8 * pooled(values[other::2])


def test_both_variants_of_a_pair_have_the_same_disturbances() -> None:
    system = spec(noisy=True)
    declared = system.model_copy(update={"disturbances": (Normal(0, 2).named("gust", "m/s"),)})
    for each, seeds in ((system, 2), (declared, 1)):
        found = {calibration_seed("a", 1, (0, 0), variant, each) for variant in ("nominal", "true")}
        assert len(found) == seeds
