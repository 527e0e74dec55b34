"""A plug-in: the paper's test function, in slow motion, whose rollouts misbehave by a plan outside of it.

The plan is the folder that FAULTY_PLAN names. A file `<seed>-<number>-<kind>` in it makes the rollout of that seed
misbehave once: the rollout moves the file to `taken/` first, so that the next attempt finds the next file or none. A
file `<seed>-always-<kind>` stays. A worker whose FAULTY_NODE names a kind misbehaves so in every rollout, or,
if FAULTY_SINCE names a file, in every one since that file is there. Honest results never depend on any of this.
"""

import ctypes
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from perfbound.schemas.errors import SimulationError
from perfbound.schemas.system import Column, Option, OptionValue, Parameter, SystemSpec, Variant
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.systems.base import Progress, SystemUnderTest, checked_options

STEP = 0.02
"""Seconds between two reports of progress."""
AGES = 3600
SLOW = 3.0
LEAKED: list[bytearray] = []


class FaultyFunction(SystemUnderTest):
    """J(z) = sin(z1) cos(z2) / 2, with a little noise in `true`; a rollout lasts `pace` seconds of the wall clock.

    Without a horizon a trajectory has one sample, else one every tenth of a second, of a value that dies out.
    """

    @cached_property
    def spec(self) -> SystemSpec:
        """As the test function has it."""
        return SystemSpec(
            name="faulty-function",
            doc="the test function in slow motion",
            parameters=tuple(Parameter(name=name, unit="1", low=0.0, high=5.0) for name in ("z1", "z2")),
            columns=(Column(name="t", unit="s"), Column(name="value", unit="1")),
            options=(Option(name="pace", default=0.08, low=0.0, high=3600.0, unit="s", doc="duration of a rollout"),),
            max_horizon=3600.0,
            versions={"faulty-function": "1.0"},
        )

    def rollout(
        self,
        x: Sequence[float],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> Trajectory:
        """Evaluate the function at `x`, unless the plan has something else in mind.

        Raises:
            SimulationError: an argument is not finite or outside the spec.
            Cancelled: raised by `progress`.

        """
        pace = float(checked_options(self.spec, x, variant=variant, horizon=horizon, options=options)["pace"])
        kind = _of_node() or _taken(seed)
        _last(pace / 2, progress)
        if kind in BEFORE:
            BEFORE[kind](progress)
        _last(pace / 2, progress)
        times = np.linspace(0.0, horizon, 1 + round(10 * horizon))
        values = honest(x, variant, seed) * np.exp(-times)
        found = Trajectory(("t", "value"), np.column_stack([times, values]))
        if kind == "lie":
            return replace(found, samples=found.samples + np.array([0.0, 0.001]))
        return AFTER[kind](found) if kind in AFTER else found


def honest(x: Sequence[float], variant: Variant, seed: int) -> float:
    """Return the value at the beginning of the trajectory."""
    noise = 0.001 * np.random.default_rng(seed).standard_normal() if variant == "true" else 0.0
    return math.sin(x[0]) * math.cos(x[1]) / 2 + noise


def _of_node() -> str | None:
    since = os.environ.get("FAULTY_SINCE")
    return os.environ.get("FAULTY_NODE") if since is None or Path(since).exists() else None


def _last(seconds: float, progress: Progress) -> None:
    for step in range(max(1, round(seconds / STEP))):
        time.sleep(min(seconds, STEP))
        progress(step)


def _taken(seed: int) -> str | None:
    """Return how this rollout shall misbehave, and cross that out of the plan."""
    plan = Path(os.environ.get("FAULTY_PLAN", "/nonexistent"))
    for file in sorted(plan.glob(f"{seed}-*")):
        _, number, kind = file.name.split("-")
        if number == "always":
            return kind
        try:
            file.rename(plan / "taken" / file.name)
        except FileNotFoundError:
            continue  # another attempt was quicker
        os.utime(plan / "taken" / file.name)
        return kind
    return None


def _hold_the_gil(_: Progress) -> None:
    ctypes.PyDLL(None).sleep(AGES)


def _raise(_: Progress) -> None:
    raise RuntimeError("the solver did not converge\nat all \udcff")


def _refuse(_: Progress) -> None:
    raise SimulationError("")


def _exit(_: Progress) -> None:
    os._exit(3)


def _leave(_: Progress) -> None:
    sys.exit("no licence")


def _crash(_: Progress) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _print(_: Progress) -> None:
    for _line in range(2000):
        print("b3Warning: " + 80 * "x", flush=True)  # noqa: T201
        os.write(1, b"from C, too\n")
    print("one line of talk", file=sys.stderr)  # noqa: T201


def _leak(_: Progress) -> None:
    LEAKED.append(bytearray(50 * 2**20))


def _sleep(_: Progress) -> None:
    time.sleep(AGES)


def _lack(_: Progress) -> None:
    raise ImportError("libsimulator.so: cannot open shared object file")


def _delay(progress: Progress) -> None:
    _last(SLOW, progress)


def _dawdle(progress: Progress) -> None:
    _last(AGES, progress)


BEFORE: dict[str, Callable[[Progress], None]] = {
    "gil": _hold_the_gil,
    "raise": _raise,
    "refuse": _refuse,
    "exit": _exit,
    "leave": _leave,
    "crash": _crash,
    "print": _print,
    "leak": _leak,
    "sleep": _sleep,
    "dawdle": _dawdle,
    "lack": _lack,
    "slow": _delay,
}


def _nan(found: Trajectory) -> Trajectory:
    return replace(found, samples=found.samples * np.nan)


def _shape(found: Trajectory) -> Trajectory:
    return replace(found, samples=found.samples[0])


def _columns(found: Trajectory) -> Trajectory:
    return replace(found, columns=("t", "something"))


def _none(_: Trajectory) -> Trajectory:
    return None  # type: ignore[return-value]


def _huge(found: Trajectory) -> Trajectory:
    return replace(found, samples=np.column_stack([found.samples[:, 0], np.full(len(found.samples), 1.7e308)]))


def _short(found: Trajectory) -> Trajectory:
    return replace(found, samples=found.samples[: len(found.samples) // 2])


def _late(found: Trajectory) -> Trajectory:
    return replace(found, samples=found.samples + np.array([0.5, 0.0]))


def _grid(found: Trajectory) -> Trajectory:
    times = found.samples[:, 0]
    inner = (times > 0.0) & (times < times[-1])
    return replace(found, samples=found.samples + np.outer(0.01 * inner, [1.0, 0.0]))


BIG = 3_000_000
"""Samples of a big result: 48 MB."""


def _big(found: Trajectory) -> Trajectory:
    times = np.arange(BIG) / BIG
    return replace(found, samples=np.column_stack([times, np.random.default_rng(1).standard_normal(BIG)]))


AFTER: dict[str, Callable[[Trajectory], Trajectory]] = {
    "nan": _nan,
    "shape": _shape,
    "columns": _columns,
    "none": _none,
    "huge": _huge,
    "short": _short,
    "late": _late,
    "grid": _grid,
    "big": _big,
}
