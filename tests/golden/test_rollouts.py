"""Comparison of rollouts with those on record, against unintended changes.

Two comparisons, because equal code does not give equal bits everywhere:

* On every platform, the numbers on record are met within 1e-9. Another C library or instruction set rounds the last
  bit of a tanh or an atan2 otherwise; over a rollout that grows to 3e-13 (measured with FMA and AVX2 switched off), a
  thousandth of the tolerance. A change of the model, the controller or the order of the engine's calls is far above.
* On a class of platforms on record, every digest is met: not one bit changed. Elsewhere, unequal digests are no sign
  of a change of the code, and the comparison is skipped, visibly. The key of a class names what was found to matter,
  or may: a part of the platform that it does not name would show as a failure, never as a false pass.

Whatever the platform, a rollout depends on nothing that ran before it.
"""

import json
import math
from typing import Any

import numpy as np
import pytest

from perfbound.workers.systems.segway import SegwaySystem
from tests.golden.record import (
    PLATFORMS,
    ROLLOUTS,
    TOLERANCE,
    differs,
    numbers,
    on_record,
    platform_file,
    platform_key,
    record,
    simulated,
)

pytestmark = pytest.mark.smoke
GOLDEN = on_record()
SYSTEM = SegwaySystem()

Record = dict[str, Any]


@pytest.fixture(scope="module")
def found() -> dict[str, Record]:
    """The record that would be made now."""
    return {name: record(SYSTEM, rollout) for name, rollout in ROLLOUTS.items()}


def test_the_record_is_of_these_rollouts() -> None:
    assert {name: entry["rollout"] for name, entry in GOLDEN.items()} == ROLLOUTS


@pytest.mark.parametrize("name", ROLLOUTS)
def test_the_numbers_are_those_on_record(name: str, found: dict[str, Record]) -> None:
    now, then = found[name]["numbers"], GOLDEN[name]["numbers"]
    assert now["length"] == then["length"]
    for key in ("last", "mean", "max_abs_phi"):
        assert now[key] == pytest.approx(then[key], rel=0, abs=TOLERANCE), key
    assert not differs(now, then)


@pytest.mark.parametrize("name", ROLLOUTS)
def test_on_a_platform_on_record_not_one_bit_changed(name: str, found: dict[str, Record]) -> None:
    if not (file := platform_file(platform_key())).exists():
        pytest.skip(f"{file.name} is not on record; record it with `python -m tests.golden`, and commit it")
    assert found[name]["digests"] == json.loads(file.read_text())["digests"][name]


def test_every_platform_on_record_has_its_name_and_these_rollouts() -> None:
    for path in sorted(PLATFORMS.iterdir()):
        held = json.loads(path.read_text())
        assert path == platform_file(held["platform"])
        assert held["digests"].keys() == ROLLOUTS.keys()


def test_another_number_is_seen_and_the_last_bit_is_not() -> None:
    then = GOLDEN["noise"]["numbers"]
    assert not differs(then | {"max_abs_phi": math.nextafter(then["max_abs_phi"], 1.0)}, then)
    for key in ("last", "mean"):
        assert differs(then | {key: [*then[key][:-1], then[key][-1] + 2 * TOLERANCE]}, then)
    assert differs(then | {"length": then["length"] + 1}, then)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_rollouts_does_not_matter(seed: int, found: dict[str, Record]) -> None:
    for name in np.random.default_rng(seed).permutation(list(ROLLOUTS)).tolist():
        assert record(SYSTEM, ROLLOUTS[name]) == found[name], name


def test_the_smallest_change_of_a_start_shows_in_the_bits_alone(found: dict[str, Record]) -> None:
    moved = ROLLOUTS["worst corner"] | {"x": [math.nextafter(5.0, 0.0), 0.0]}
    now, then = record(SYSTEM, moved), found["worst corner"]
    assert now["digests"]["samples_sha256"] != then["digests"]["samples_sha256"]
    assert now["numbers"]["last"] == pytest.approx(then["numbers"]["last"], rel=0, abs=1e-9)


def test_the_numbers_see_every_row() -> None:
    trajectory = simulated(SYSTEM, ROLLOUTS["one step"])
    assert numbers(trajectory)["mean"][0] == pytest.approx(1 / 240)
    assert numbers(trajectory)["max_abs_phi"] == abs(trajectory.samples[:, 6]).max()
