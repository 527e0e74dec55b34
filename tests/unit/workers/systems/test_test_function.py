import math
import sys
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from perfbound.schemas.errors import SimulationError, UnknownSystemError
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import OptionValue
from perfbound.schemas.trajectory.trajectory import Trajectory, decode
from perfbound.workers import simulate, systems
from perfbound.workers.systems.base import Cancelled
from perfbound.workers.systems.test_function import TestFunctionSystem

SYSTEM = TestFunctionSystem()


def rollout(*x: float, variant: Any = "nominal", seed: int = 0, **options: OptionValue) -> Trajectory:
    return SYSTEM.rollout(x, variant=variant, seed=seed, horizon=0.0, options=options, progress=lambda _: None)


def a_request(**changes: Any) -> RolloutRequest:
    fields: dict[str, Any] = {
        "campaign": "paper",
        "config_sha256": "0" * 64,
        "problem": "sim_gap",
        "test": 12,
        "variant": "true",
        "replicate": 3,
        "seed": 2**53 - 1,
        "system": "test-function",
        "spec_sha256": systems.load_system("test-function").spec.digest,
        "x": (1.0, 2.0),
        "horizon": 1.0,
    }
    return RolloutRequest.model_validate(fields | changes)


def test_nominal_is_the_function() -> None:
    for z1, z2 in [(0.0, 0.0), (1.0, 2.0), (math.pi / 2, 0.0), (5.0, 5.0)]:
        assert rollout(z1, z2).samples.tolist() == [[0.0, math.sin(z1) * math.cos(z2) / 2]]


def test_true_is_the_function_with_noise_of_the_given_sd() -> None:
    values = [rollout(1.0, 2.0, variant="true", seed=seed, noise_sd=0.1).samples[0, 1] for seed in range(2000)]
    errors = np.array(values) - math.sin(1.0) * math.cos(2.0) / 2
    assert abs(errors.mean()) < 4 * 0.1 / math.sqrt(2000)
    assert errors.std() == pytest.approx(0.1, rel=0.07)
    assert rollout(1.0, 2.0, variant="true", noise_sd=0.0).samples[0, 1] == rollout(1.0, 2.0).samples[0, 1]


def test_the_seed_decides() -> None:
    assert rollout(1.0, 2.0, variant="true", seed=4).samples == pytest.approx(
        rollout(1.0, 2.0, variant="true", seed=4).samples, abs=0
    )
    assert rollout(1.0, 2.0, variant="true", seed=4).samples[0, 1] != rollout(1.0, 2.0, variant="true").samples[0, 1]


@pytest.mark.parametrize(
    ("x", "changes"),
    [
        ((math.nan, 0.0), {}),
        ((math.inf, 0.0), {}),
        ((5.1, 0.0), {}),
        ((1.0,), {}),
        ((1.0, 1.0), {"noise_sd": 1.5}),
        ((1.0, 1.0), {"noise_sd": "much"}),
        ((1.0, 1.0), {"noise_sd": math.nan}),
        ((1.0, 1.0), {"gain": 1.0}),
        ((1.0, 1.0), {"variant": "other"}),
    ],
)
def test_what_is_outside_the_spec_is_refused(x: tuple[float, ...], changes: dict[str, Any]) -> None:
    with pytest.raises(SimulationError):
        rollout(*x, **changes)


@pytest.mark.parametrize("horizon", [-1.0, math.nan, math.inf])
def test_a_horizon_outside_the_spec_is_refused(horizon: float) -> None:
    with pytest.raises(SimulationError, match="horizon"):
        SYSTEM.rollout((1.0, 1.0), variant="nominal", seed=0, horizon=horizon, options={}, progress=lambda _: None)


def test_the_registry_names_what_is_there() -> None:
    assert {"segway", "test-function"} <= set(systems.available())
    assert systems.load_system("test-function").spec.parameters == TestFunctionSystem().spec.parameters
    assert systems.load_system("test-function") is systems.load_system("test-function")
    with pytest.raises(UnknownSystemError, match=r"'unicycle'.*segway, segway-mujoco, test-function"):
        systems.load_system("unicycle")


def test_a_request_becomes_a_file() -> None:
    request = a_request()
    data = simulate.run_request(request, lambda _: None)
    assert data == simulate.run_request(request, lambda _: None)
    assert decode(data).columns == ("t", "value")
    assert decode(data).samples[0, 1] == rollout(1.0, 2.0, variant="true", seed=2**53 - 1).samples[0, 1]


def test_a_system_without_visual_shows_nothing() -> None:
    seen = decode(simulate.run_request(a_request(visual=True), lambda _: None))
    assert (seen.samples == decode(simulate.run_request(a_request(), lambda _: None)).samples).all()


def test_the_rollout_has_a_name_and_metadata() -> None:
    request = a_request()
    assert request.rollout == "sim_gap.12.true.3"
    assert request.metadata == {
        "campaign": "paper",
        "problem": "sim_gap",
        "test": "12",
        "variant": "true",
        "replicate": "3",
        "seed": "9007199254740991",
        "system": "test-function",
        "config_sha256": "0" * 64,
        "rollout": "sim_gap.12.true.3",
    }
    assert RolloutRequest.model_validate_json(request.model_dump_json()) == request


@pytest.mark.parametrize(
    "changes",
    [{"seed": 2**53}, {"seed": -1}, {"x": (math.nan, 0.0)}, {"x": ()}, {"horizon": -1.0}, {"extra": 1}, {"test": "1"}],
)
def test_a_bad_request_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        a_request(**changes)


def test_another_build_of_the_system_is_refused() -> None:
    with pytest.raises(SimulationError, match="another build of test-function"):
        simulate.run_request(a_request(spec_sha256="1" * 64), lambda _: None)


def test_a_system_that_returns_other_columns_is_refused() -> None:
    class Liar(TestFunctionSystem):
        def rollout(self, x: Any, **rest: Any) -> Trajectory:
            return Trajectory(("t", "other"), np.zeros((1, 2)))

    with pytest.raises(SimulationError, match="columns"):
        simulate.run_request_on(Liar(), a_request(), lambda _: None)


def test_a_cancelled_rollout_stops() -> None:
    def cancel(step: int) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        simulate.run_request(a_request(), cancel)


@pytest.mark.rest
@pytest.mark.integration
def test_specs_cost_no_simulator() -> None:
    import subprocess

    code = "import sys; from perfbound.workers.systems import usable; usable(); "
    code += "sys.exit(any(m in sys.modules for m in ('pybullet', 'scipy', 'sklearn', 'sqlalchemy', 'zenoh')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
