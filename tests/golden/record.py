"""The rollouts on record, and how a record of one is made.

`segway.json` has the rollouts with their numbers, which every platform meets. `platforms/` has one file for each class
of platforms (CPU, C library, versions of packages) with digests, which show that not one bit changed: of the samples,
of the file with the evidence alone, of the file with its visual part.
"""

import hashlib
import json
import math
import platform
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from perfbound.schemas.platforms import class_name, cpu
from perfbound.schemas.trajectory.trajectory import Trajectory, encode
from perfbound.workers.systems.base import SystemUnderTest
from perfbound.workers.systems.segway.bullet import providers
from tests.fakes.segway import STILL, errors

FILE = Path(__file__).with_name("segway.json")
PLATFORMS = Path(__file__).with_name("platforms")
DECIDING_PACKAGES = ("foxglove-schemas-protobuf", "lz4", "mcap", "numpy", "protobuf", "zstandard")

TOLERANCE = 1e-9

Numbers = dict[str, Any]
Rollout = dict[str, Any]
"""Start, variant, horizon and options; of the variant `true` the seed and the variance of its errors, too."""


def _rollout(x: float, y: float, *, horizon: float = 15.0, seed: int | None = None, **options: Any) -> Rollout:
    variant = "nominal" if seed is None else "true"
    return {"x": [x, y], "variant": variant, "seed": seed or 0, "horizon": horizon, "options": options}


ROLLOUTS: dict[str, Rollout] = {
    "worst corner": _rollout(5.0, 0.0),
    "worst corner, aggressive": _rollout(5.0, 0.0, gains="aggressive"),
    "nearest corner": _rollout(0.0, 0.0),
    "at the goal": _rollout(2.5, 2.5),
    "goal almost behind": _rollout(4.5, 2.51, gains="aggressive"),  # exactly behind, rounding decides the turn
    "noise": _rollout(1.25, 3.75, seed=7),
    "noise, aggressive": _rollout(5.0, 5.0, seed=2**53 - 1, gains="aggressive"),
    "noise of variance zero": _rollout(3.3, 0.2, seed=11, noise_variance=0.0),
    "falls after one second": _rollout(5.0, 0.0, seed=50, gains="aggressive", noise_variance=0.5),
    "falls after three seconds": _rollout(5.0, 0.0, seed=598, gains="aggressive", noise_variance=0.5),
    "starts on the ground": _rollout(5.0, 0.0, seed=14, noise_variance=0.6),
    "outside the box": _rollout(-20.0, 25.0, gains="aggressive"),
    "no step": _rollout(1.0, 1.0, horizon=0.0),
    "one step": _rollout(1.0, 1.0, horizon=1 / 120),
    "between two steps": _rollout(1.0, 4.0, seed=3, horizon=7.3456),
    "longer than a campaign's": _rollout(0.1, 4.9, seed=5, horizon=31.0),
}


def record(system: SystemUnderTest, rollout: Rollout) -> dict[str, Any]:
    """Return what is on record of one rollout: the numbers of `numbers`, and digests."""
    trajectory = simulated(system, rollout)
    seen = replace(trajectory, visual=system.visual(trajectory))
    return {
        "numbers": numbers(trajectory),
        "digests": {
            "samples_sha256": _sha256(trajectory.samples.tobytes()),
            "file_sha256": _sha256(_file(system, trajectory, rollout)),
            "visual_file_sha256": _sha256(_file(system, seen, rollout)),
        },
    }


def simulated(system: SystemUnderTest, rollout: Rollout) -> Trajectory:
    """Return the trajectory of a rollout, whose disturbances follow from its seed and its variance."""
    options = dict(rollout["options"])
    variance = options.pop("noise_variance", 0.05)
    drawn = errors(rollout["seed"], variance) if rollout["variant"] == "true" else STILL
    return system.rollout(**(rollout | {"options": options, "disturbances": drawn}), progress=lambda _: None)


def differs(now: Numbers, then: Numbers) -> bool:
    """Return whether the numbers of a rollout are others than those on record, beyond what platforms differ by."""
    pairs = [(now["max_abs_phi"], then["max_abs_phi"])]
    for key in ("last", "mean"):
        pairs += zip(now[key], then[key], strict=True)
    return now["length"] != then["length"] or any(abs(one - other) > TOLERANCE for one, other in pairs)


def numbers(trajectory: Trajectory) -> Numbers:
    """Return the length, the last row, the mean of every column (exactly rounded sums) and the largest |phi|."""
    columns = trajectory.samples.T.tolist()
    return {
        "length": len(trajectory.samples),
        "last": trajectory.samples[-1].tolist(),
        "mean": [math.fsum(column) / len(column) for column in columns],
        "max_abs_phi": float(np.abs(trajectory.column("phi")).max()),
    }


def platform_key() -> dict[str, str]:
    """Return what may decide the last bits of a rollout or the bytes of its file.

    The C library and numpy choose their sin, tanh or atan2 by the instruction sets of the CPU; Python brings its own
    hypot, pybullet its own compiled code; mcap, protobuf and the compressions decide the bytes around the samples.
    """
    packages = {package: version(package) for package in DECIDING_PACKAGES} | providers()
    python = ".".join(platform.python_version_tuple()[:2])
    libc = " ".join(platform.libc_ver())
    return {"machine": platform.machine(), "cpu": cpu(), "libc": libc, "python": python} | packages


def platform_file(key: dict[str, str]) -> Path:
    """Return the file of a class of platforms; its name contains the CPU and the C library, and a digest the rest.

    >>> platform_file({"cpu": "GenuineIntel 6 fma avx2", "libc": "glibc 2.36"}).name
    'genuineintel-6-fma-avx2-glibc-2.36-ec2c5de4.json'
    """
    name = class_name(key["cpu"], key["libc"])
    return PLATFORMS / f"{name}-{_sha256(json.dumps(key, sort_keys=True).encode())[:8]}.json"


def on_record() -> dict[str, dict[str, Any]]:
    """Return the rollouts with their numbers."""
    return dict(json.loads(FILE.read_text()))


def write_numbers(found: dict[str, Any]) -> None:
    """Write the rollouts with their numbers anew; the digests of every platform are then those of other rollouts."""
    rows = {name: {"rollout": ROLLOUTS[name], "numbers": each["numbers"]} for name, each in found.items()}
    FILE.write_text(json.dumps(rows, indent=1) + "\n")
    for path in PLATFORMS.glob("*.json"):
        path.unlink()


def write_platform(key: dict[str, str], found: dict[str, Any]) -> Path:
    """Write the digests of a class of platforms; return its file."""
    path = platform_file(key)
    path.parent.mkdir(exist_ok=True)
    rows = {name: each["digests"] for name, each in found.items()}
    path.write_text(json.dumps({"platform": key, "digests": rows}, indent=1) + "\n")
    return path


def _file(system: SystemUnderTest, trajectory: Trajectory, rollout: Rollout) -> bytes:
    """Return the file that a worker would send, without the digest of the system's spec, which covers prose."""
    units = {column.name: column.unit for column in system.spec.columns}
    return encode(trajectory, request=rollout, metadata={"seed": str(rollout["seed"])}, units=units)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
