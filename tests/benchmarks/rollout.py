"""CPU seconds of one nominal rollout of the Segway, from the bare engine to the bytes of its file.

Run as a script; `main` returns the numbers. CPU time of this process, best of several repeats: the machine is shared.
"""

import subprocess
import sys
import time
from collections.abc import Callable

from schemas.rollout import RolloutRequest
from schemas.trajectory import decode
from workers.simulate import run_on
from workers.systems.segway import SegwaySystem
from workers.systems.segway.bullet import CONTROL_RATE, Start, World

REPEATS = 15
HORIZON = 15.0  # s
START = (5.0, 0.0)  # m, the worst nominal start

Results = dict[str, float]


def main() -> Results:
    """Measure, print a table and return CPU seconds, rollouts per core-second and bytes by name."""
    results = measure()
    for name, value in results.items():
        print(f"{name:36s} {value:12.4f}")  # noqa: T201  (a script)
    return results


def measure() -> Results:
    """Return every number of the table."""
    system = SegwaySystem()
    plain, visual = a_request(system, visual=False), a_request(system, visual=True)
    data, data_visual = run_on(system, plain, _ignore), run_on(system, visual, _ignore)
    full = cpu_seconds(lambda: run_on(system, visual, _ignore))
    evidence = cpu_seconds(lambda: run_on(system, plain, _ignore))
    return {
        "engine_steps_s": bare_steps(),
        "rollout_s": cpu_seconds(lambda: rollout(system)),
        "rollout_and_file_s": evidence,
        "rollout_and_visual_file_s": full,
        "decode_s": cpu_seconds(lambda: decode(data)),
        "decode_visual_s": cpu_seconds(lambda: decode(data_visual)),
        "rollouts_per_core_second": 1 / evidence,
        "visual_rollouts_per_core_second": 1 / full,
        "file_bytes": len(data),
        "visual_file_bytes": len(data_visual),
        "import_s": fresh_process("import workers.simulate, workers.systems.segway") - fresh_process("pass"),
        "import_and_first_world_s": fresh_process("from workers.systems.segway.bullet import World; World()")
        - fresh_process("pass"),
    }


def cpu_seconds(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the CPU seconds of the fastest of several calls."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def bare_steps() -> float:
    """Return the CPU seconds of stepSimulation alone, for as many steps as a rollout has."""
    world = World()

    def steps() -> None:
        world._build(Start(*START, phi=0.0))
        for _ in range(round(CONTROL_RATE * HORIZON)):
            world._bullet.stepSimulation(world._client)

    return cpu_seconds(steps)


def rollout(system: SegwaySystem) -> object:
    """Simulate once, without a file."""
    return system.rollout(START, variant="nominal", seed=0, horizon=HORIZON, options={}, progress=_ignore)


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
    )


def fresh_process(code: str, repeats: int = 3) -> float:
    """Return the CPU seconds of a fresh interpreter that runs `code`."""
    probe = f"import time\n{code}\nprint(time.process_time())"
    outputs = [subprocess.check_output([sys.executable, "-c", probe], text=True) for _ in range(repeats)]
    return min(float(output) for output in outputs)


def _ignore(step: int) -> None:
    """Take no notice of the progress."""


if __name__ == "__main__":
    main()
