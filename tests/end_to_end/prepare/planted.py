"""Systems with one fault each, for `perfbound check-system`; `sound` has none."""

import ctypes
import os
import subprocess
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import perfbound as pb
from perfbound.workers.systems.function import FunctionSystem

Floats = NDArray[np.float64]
STEP = 0.1


def planted(**changes: Any) -> Callable[[Callable[..., Any]], FunctionSystem]:
    """Decorate a function of two parameters with the column `height`."""
    box = {"x": pb.Parameter(0, 1, unit="m"), "y": pb.Parameter(0, 2, unit="m")}
    return pb.system(**{"parameters": box, "columns": {"height": "m"}, "step": STEP, **changes})


def times(horizon: float) -> Floats:
    return np.arange(round(horizon / STEP) + 1, dtype=np.float64) * STEP


def height(x: float, y: float, seed: int, horizon: float) -> Floats:
    return x + y * times(horizon) + np.random.default_rng(seed).normal()


@planted()
def sound(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, horizon)


# The ten faults


@planted()
def unseeded(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, horizon) + np.random.default_rng().normal()


LAST = [0.0]


@planted()
def state(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    found = height(x, y, seed, horizon) + 1e-9 * LAST[0]
    LAST[0] = x
    return found


@planted()
def columns(x: float, y: float, *, seed: int, horizon: float) -> dict[str, Floats]:
    return {"altitude": height(x, y, seed, horizon)}


@planted()
def corner(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    with np.errstate(all="ignore"):
        return height(x, y, seed, horizon) + float(np.divide(x, y))


@planted()
def short(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, 0.8 * horizon)


@planted(step=None)
def grid(x: float, y: float, *, seed: int, horizon: float) -> dict[str, Floats]:
    return {"t": times(horizon)[1:], "height": height(x, y, seed, horizon)[1:]}


@planted()
def global_rng(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, horizon) + np.random.normal()  # noqa: NPY002


@planted()
def prints(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    print("step 0")  # noqa: T201
    return height(x, y, seed, horizon)


@planted()
def hangs(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    while x == 1:
        pass
    return height(x, y, seed, horizon)


KEPT: list[Floats] = []


@planted()
def grows(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    KEPT.append(np.ones(10_000))
    return height(x, y, seed, horizon)


# Others


@planted()
def crashes(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    if x == 1:
        ctypes.string_at(0)
    return height(x, y, seed, horizon)


@planted()
def raises(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    assert x < 1, "too far"
    return height(x, y, seed, horizon)


@planted()
def short_seeds(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, horizon) + np.random.RandomState(seed).normal()


@planted()
def exits(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    os._exit(3)


@planted()
def false_noisy(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, 0, horizon)


@planted(noisy=())
def secretly_noisy(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, horizon)


@planted()
def of_process(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    return height(x, y, seed, horizon) + 1e-9 * os.getpid()


@planted()
def seeds_global(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    np.random.seed(seed % 2**32)  # noqa: NPY002
    return x + y * times(horizon) + np.random.normal()  # noqa: NPY002


@planted()
def threads(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    threading.Thread(target=threading.Event().wait, name="viewer", daemon=True).start()
    return height(x, y, seed, horizon)


@planted()
def files(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    with open(f"log-{seed}.csv", "w") as file:
        file.write("1")
    return height(x, y, seed, horizon)


@planted()
def touches(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    subprocess.run(["touch", f"log-{seed}.csv"], check=True)
    return height(x, y, seed, horizon)


@planted(step=None)
def uneven(x: float, y: float, *, seed: int, horizon: float) -> dict[str, Floats]:
    t = times(horizon)
    return {"t": t * t / horizon, "height": height(x, y, seed, horizon)}


@planted()
def lasts_three_seconds(x: float, y: float, *, seed: int) -> Floats:
    return height(x, y, seed, 3.0)


@planted(step=None)
def one_sample(x: float, y: float) -> float:
    return x * y


@planted()
def loads_slowly_once(x: float, y: float, *, seed: int, horizon: float) -> Floats:
    if not KEPT:
        KEPT.append(np.ones(4_000_000))
        print("loaded a model")  # noqa: T201
    return height(x, y, seed, horizon)


@planted(vectorised=True)
def unrolled(x: Floats, y: Floats, *, seeds: Any, horizon: float) -> Any:
    """The last digits depend on the place in the batch."""
    found = x + 1e-12 * np.arange(len(x)) + pb.normal(seeds, 1)[:, 0]
    return found[:, np.newaxis] + y[:, np.newaxis] * times(horizon)


@planted(vectorised=True)
def mixes(x: Floats, y: Floats, *, seeds: Any, horizon: float) -> Any:
    """A rollout depends on the starts of the others."""
    found = x - x.mean() + pb.normal(seeds, 1)[:, 0]
    return found[:, np.newaxis] + y[:, np.newaxis] * times(horizon)
