"""Requests for batches, and systems that simulate them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import perfbound as pb
from perfbound.schemas.batch import BatchRequest
from perfbound.schemas.rollout import WithinBatch
from perfbound.schemas.system import SystemSpec

SHA = "0" * 64
Starts = Sequence[tuple[float, ...]]


def batch_request(spec: SystemSpec, starts: Starts, *, replicates: int = 1, **keys: Any) -> BatchRequest:
    count = len(starts) * replicates
    given: dict[str, Any] = {
        "test": 3,
        "replicate": 0,
        "variant": "nominal",
        "seeds": tuple(range(100, 100 + count)),
        "horizon": 1.0,
    }
    return BatchRequest(
        campaign="c",
        config_sha256=SHA,
        problem="mean",
        replicates=replicates,
        system=spec.name,
        spec_sha256=spec.digest,
        x=tuple(starts),
        **given | keys,
    )


def within(batch: BatchRequest, place: int) -> WithinBatch:
    """Return the batch for a request that repeats it for the rollout in this place."""
    return WithinBatch(x=batch.x, seeds=batch.seeds, place=place)


@pb.system(parameters={"a": pb.Parameter(0, 10, unit="m")}, columns={"y": "m", "z": "m"}, step=0.25)
def one(a: float, *, seed: int, horizon: float = 1.0, gain: float = 2.0) -> tuple[Any, Any]:
    """One rollout at a time; `a` above 9 m fails, above 8 m it is not finite."""
    if a > 9:
        raise RuntimeError("the model diverged")
    t = np.arange(int(horizon / 0.25) + 1) * 0.25
    return a + gain * t + seed * 1e-3, a - t if a <= 8 else np.full(len(t), np.nan)


@pb.system(parameters={"a": pb.Parameter(0, 10, unit="m")}, columns={"y": "m", "z": "m"}, step=0.25, vectorised=True)
def many(a: Any, *, seeds: Any, horizon: float = 1.0, gain: float = 2.0) -> dict[str, Any]:
    """The same as arrays, without a way to fail but numbers that are not finite."""
    t = np.arange(int(horizon / 0.25) + 1) * 0.25
    each = a[:, np.newaxis]
    return {"y": each + gain * t + seeds[:, np.newaxis] * 1e-3, "z": np.where(each <= 8, each - t, np.nan)}
