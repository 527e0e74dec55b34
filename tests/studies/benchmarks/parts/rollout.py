"""CPU time of one nominal rollout of the Segway, from the bare engine to the bytes of its file; best of several."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import decode
from perfbound.workers.simulate import run_request_on
from perfbound.workers.systems import segway
from perfbound.workers.systems.segway import SegwaySystem
from tests.fakes.segway import STILL
from tests.studies.benchmarks.report import Row

CONTROL_RATE, SUB_STEPS, WHEEL_RADIUS = 120, 2, 0.195  # 1/s, physics steps per control step, m
REPEATS = 15
HORIZON = 15.0  # s
START = (5.0, 0.0)  # m, the worst nominal start
MODEL = Path(segway.__file__).with_name("model.urdf")


def main() -> list[Row]:
    """Return every row; the peer is the engine without controller, readings and file."""
    system, bare = SegwaySystem(), bare_steps()
    requests = {name: a_request(system, visual=name == "all") for name in ("none", "all")}
    rows = [
        Row("bare engine, 1800 steps of 1/120 s", 1000 * bare, "ms"),
        Row("rollout", 1000 * cpu_seconds(lambda: rollout(system)), "ms", "bare engine", 1000 * bare),
    ]
    for name, request in requests.items():
        rows += _with_file(system, request, f'rollout and file, visual = "{name}"', bare)
    start = fresh_process("pass")
    for name, code in FRESH.items():
        rows.append(Row(f"a fresh worker: {name}", fresh_process(code) - start, "s"))
    return rows


FRESH = {
    "imports": "import perfbound.workers.simulate, perfbound.workers.systems.segway",
    "imports and the simulator": "import perfbound.workers.simulate, perfbound.workers.systems.segway, pybullet",
}


def _with_file(system: SegwaySystem, request: RolloutRequest, label: str, bare: float) -> list[Row]:
    data = run_request_on(system, request, _ignore)
    seconds = cpu_seconds(lambda: run_request_on(system, request, _ignore))
    return [
        Row(label, 1000 * seconds, "ms", "bare engine", 1000 * bare),
        Row(f"{label}, per core-second", 1 / seconds, "rollouts/s", "bare engine", 1 / bare),
        Row(f"{label}: reading it", 1000 * cpu_seconds(lambda: decode(data)), "ms"),
        Row(f"{label}: size", len(data) / 1000, "kB"),
    ]


def cpu_seconds(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the CPU seconds of the fastest of several calls."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def bare_steps() -> float:
    """Return the CPU seconds of stepSimulation alone, for as many steps as a rollout has.

    The world is built as `perfbound.workers.systems.segway.bullet` builds it, and is upright at rest.
    """
    import pybullet  # not there on every Python

    client = pybullet.connect(pybullet.DIRECT)
    steps = round(CONTROL_RATE * HORIZON)

    def run() -> None:
        pybullet.resetSimulation()
        pybullet.setGravity(0, 0, -9.81)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1 / CONTROL_RATE, numSubSteps=SUB_STEPS, physicsClientId=client
        )
        pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE))
        body = pybullet.loadURDF(str(MODEL), (*START, WHEEL_RADIUS), flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
        pybullet.setJointMotorControlArray(body, (0, 1), pybullet.VELOCITY_CONTROL, forces=(0.0, 0.0))
        start = time.process_time()
        for _ in range(steps):
            pybullet.stepSimulation()
        times.append(time.process_time() - start)

    times: list[float] = []
    for _ in range(REPEATS):
        run()
    pybullet.disconnect(client)
    return min(times)


def rollout(system: SegwaySystem) -> object:
    """Simulate once, without a file."""
    common: Any = {"variant": "nominal", "seed": 0, "horizon": HORIZON, "options": {}, "disturbances": STILL}
    return system.rollout(START, **common, progress=_ignore)


def a_request(system: SegwaySystem, *, visual: bool) -> RolloutRequest:
    """Return the request that a campaign would send."""
    return RolloutRequest(
        campaign="benchmark",
        config_sha256="0" * 64,
        problem="nominal_robustness",
        test=0,
        variant="nominal",
        replicate=0,
        seed=0,
        system=system.spec.name,
        spec_sha256=system.spec.digest,
        x=START,
        horizon=HORIZON,
        visual=visual,
        disturbances=tuple(STILL.values()),
    )


def fresh_process(code: str, repeats: int = 3) -> float:
    """Return the CPU seconds of a fresh interpreter that runs `code`."""
    probe = f"import time\n{code}\nprint(time.process_time())"
    outputs = [subprocess.check_output([sys.executable, "-c", probe], text=True) for _ in range(repeats)]
    return min(float(output) for output in outputs)


def _ignore(step: int) -> None:
    """Ignore the progress."""
