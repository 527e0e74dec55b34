"""CPU time that each form of a system adds to a bare call of the same function, 300 samples of 4 columns."""

import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import perfbound as pb
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import Floats
from perfbound.systems import OptionValue, Progress, Variant
from perfbound.workers.simulate import run_request_on
from perfbound.workers.systems.files import load_reference
from tests.studies.benchmarks.parts.rollout import cpu_seconds
from tests.studies.benchmarks.report import Row

SAMPLES, STEP = 300, 0.01  # , s
CALLS, ROUNDS = 200, 10
NAMES = ("a", "b", "c", "d")
START, SEED = (0.5, 1.0), 7
ABOUT: dict[str, Any] = {
    "parameters": {"x": pb.Parameter(0, 1, unit="m"), "v": pb.Parameter(0, 2, unit="m/s")},
    "columns": dict.fromkeys(NAMES, "m"),
    "step": STEP,
}


def simulated(x: float, v: float, seed: int, horizon: float) -> Floats:
    """Return the samples, shape (300, 4): what a simulator would do is left out."""
    t = np.arange(0.0, horizon - STEP / 2, STEP)
    noise = np.random.default_rng(seed).normal(0.0, 0.1)
    return np.column_stack([x + v * t + noise, v * t, np.sin(t), np.cos(t)])


@pb.system(**ABOUT)
def function(x: float, v: float, *, seed: int, horizon: float) -> Floats:
    """A function under the decorator."""
    return simulated(x, v, seed, horizon)


class Called:
    """A class under the decorator."""

    def __call__(self, x: float, v: float, *, seed: int, horizon: float) -> Floats:
        """Simulate."""
        return simulated(x, v, seed, horizon)


class Packaged(pb.SystemUnderTest):
    """A class of a package."""

    spec = function.spec.model_copy(update={"name": "packaged"})

    def rollout(
        self,
        x: Sequence[float],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> pb.Trajectory:
        """Simulate."""
        pb.checked_options(self.spec, x, variant=variant, horizon=horizon, options=options)
        samples = simulated(x[0], x[1], seed, horizon)
        t = np.arange(len(samples)) * STEP
        progress(len(samples))
        return pb.Trajectory(("t", *NAMES), np.column_stack([t, samples]))


PROGRAM = """
import json, sys
import numpy as np
for line in sys.stdin:
    request = json.loads(line)
    x, v, horizon = request["start"]["x"], request["start"]["v"], request["horizon"]
    t = np.arange(0.0, horizon - 0.005, 0.01)
    noise = np.random.default_rng(request["seed"]).normal(0.0, 0.1)
    np.column_stack([x + v * t + noise, v * t, np.sin(t), np.cos(t)]).tofile(request["path"])
    print('{"done": true}', flush=True)
"""
CAMPAIGN = """
name = "program"
seed = 1
horizon = 3.0
specification = "always (a >= 0)"
clip = [-1.0, 1.0]
[system]
program = ["PYTHON", "program.py"]
columns = { a = "m", b = "m", c = "m", d = "m" }
step = 0.01
samples = "f64"
noisy = true
[space]
x = { low = 0.0, high = 1.0, unit = "m" }
v = { low = 0.0, high = 2.0, unit = "m/s" }
[[problems]]
name = "robustness"
method = "rigorous"
alpha = 0.1
rkhs_norm = 1.0
noise_scale = 0.1
kernel = { length_scale = 1.0 }
"""


def program(folder: Path) -> pb.SystemUnderTest:
    """Return the same simulator as a program that stays for many rollouts and writes raw floats."""
    (folder / "program.py").write_text(PROGRAM)
    (folder / "program.toml").write_text(CAMPAIGN.replace("PYTHON", sys.executable))
    return load_reference(str(folder / "program.toml"))


FORMS: dict[str, tuple[pb.SystemUnderTest, float]] = {
    "function": (function, 0.3),
    "class under the decorator": (pb.system(**ABOUT)(Called), 0.2),
    "class in a package": (Packaged(), 0.2),
}
"""Each form with the most that it may add to a rollout, in ms."""


PROGRAM_AT_MOST = 1.0  # ms


def main() -> list[Row]:
    """Return a row a form, and one for the file, which all forms have in common."""
    with tempfile.TemporaryDirectory() as folder:
        return [*_in_process(), *_of_program(Path(folder))]


def _of_program(folder: Path) -> list[Row]:
    """Return the cost of a program; it computes in a process of its own, so that the time of the clock counts."""
    system = program(folder)
    calls = {"bare": lambda: simulated(*START, SEED, SAMPLES * STEP), "program": _rollout(system)}
    ms = dict.fromkeys(calls, float("inf"))
    for _ in range(ROUNDS):
        for name, call in calls.items():
            began = time.perf_counter()
            _often(call)
            ms[name] = min(ms[name], 1000 * (time.perf_counter() - began) / CALLS)
    cost = ms["program"] - ms["bare"]
    return [Row("program with raw floats, over a bare call, wall time", cost, "ms", at_most=PROGRAM_AT_MOST)]


def _in_process() -> list[Row]:
    rollouts = {name: _rollout(system) for name, (system, _) in FORMS.items()}
    calls = {"bare": lambda: simulated(*START, SEED, SAMPLES * STEP), **rollouts, "file": _with_file(Packaged())}
    ms = dict.fromkeys(calls, float("inf"))
    for _ in range(ROUNDS):  # in turn, so that a busy machine is busy for all of them
        for name, call in calls.items():
            ms[name] = min(ms[name], 1000 * cpu_seconds(partial(_often, call), 1) / CALLS)
    bare = ms["bare"]
    return [
        Row("bare call, 300 samples of 4 columns", bare, "ms"),
        *(Row(f"{name}, over a bare call", ms[name] - bare, "ms", at_most=most) for name, (_, most) in FORMS.items()),
        Row("file of these samples, in every form", ms["file"] - ms["class in a package"], "ms"),
    ]


def _often(call: Callable[[], object]) -> None:
    for _ in range(CALLS):
        call()


def _rollout(system: pb.SystemUnderTest) -> Callable[[], object]:
    horizon = SAMPLES * STEP
    return lambda: system.rollout(
        START, variant="nominal", seed=SEED, horizon=horizon, options={}, progress=lambda _: None
    )


def _with_file(system: pb.SystemUnderTest) -> Callable[[], object]:
    request = RolloutRequest(
        campaign="benchmark",
        config_sha256="0" * 64,
        problem="robustness",
        test=0,
        variant="nominal",
        replicate=0,
        seed=SEED,
        system=system.spec.name,
        spec_sha256=system.spec.digest,
        x=START,
        horizon=SAMPLES * STEP,
    )
    return lambda: run_request_on(system, request, lambda _: None)
