"""A batch of trajectories and its file: the content comes back, and nothing else passes for one."""

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from perfbound.schemas.errors import TrajectoryError, UnusableTrajectoryError
from perfbound.schemas.trajectory.batch import Batch, encode_batch, read_batch
from perfbound.schemas.trajectory.canonical import EVIDENCE, OF_BATCH, REQUEST, TIME, canonical_file
from perfbound.schemas.trajectory.npy import to_npy

COLUMNS = ("t", "x", "y")
TIMES: NDArray[np.float64] = np.array([0.0, 0.1, 0.2, 0.3, 0.4])


def a_batch(failures: dict[int, str] | None = None, rollouts: int = 4) -> Batch:
    values = np.random.default_rng(0).normal(size=(2, rollouts, 5))
    values[:, list(failures or {})] = 0.0
    return Batch(COLUMNS, TIMES.copy(), values, failures or {})


def a_file(**content: bytes) -> bytes:
    found = {
        REQUEST: b"{}",
        TIME: to_npy(TIMES.copy()),
        EVIDENCE: to_npy(np.ones((2, 4, 5))),
        **{name.replace("_", "."): each for name, each in content.items()},
    }
    return canonical_file(OF_BATCH, {"columns": json.dumps(COLUMNS)}, found)


@pytest.mark.parametrize("failures", [{}, {1: "diverged", 3: "x"}])
def test_its_file_has_the_whole_content(failures: dict[int, str]) -> None:
    batch = a_batch(failures)
    file = read_batch(encode_batch(batch, request={"b": 1, "a": [0.1]}, metadata={"first": "p.0.true.0"}))
    assert file.request == b'{"a":[0.1],"b":1}'
    assert file.metadata["first"] == "p.0.true.0"
    assert file.batch.failures == failures
    assert np.array_equal(file.batch.values, batch.values)
    assert np.array_equal(file.batch.time, batch.time)


def test_a_trajectory_is_that_of_its_rollout() -> None:
    batch = a_batch({2: "diverged"})
    assert batch.succeeded == [0, 1, 3]
    found = batch.trajectory(1)
    assert found.columns == COLUMNS
    assert np.array_equal(found.column("y"), batch.values[1, 1])
    with pytest.raises(KeyError, match="diverged"):
        batch.trajectory(2)


def test_a_digest_is_that_of_the_rollout_alone() -> None:
    """Neither the other rollouts of the batch nor the place among them changes it."""
    whole, failed = a_batch(), a_batch({1: "diverged"})
    digests = list(whole.digests)
    assert len(set(digests)) == 4
    assert list(failed.digests) == [digests[0], b"", *digests[2:]]
    turned = Batch(COLUMNS, whole.time.copy(), whole.values[:, ::-1].copy())
    assert list(turned.digests) == digests[::-1]
    later = Batch(COLUMNS, whole.time + 1.0, whole.values.copy())
    assert not set(later.digests) & set(digests)


def test_equal_content_gives_equal_bytes() -> None:
    first, second = (encode_batch(a_batch({0: "a\nb"}), request={}, metadata={}) for _ in range(2))
    assert first == second


def test_a_long_reason_is_written_and_read_as_one_short_line() -> None:
    file = encode_batch(a_batch({0: "line\n" * 1000}), request={}, metadata={})
    (reason,) = read_batch(file).batch.failures.values()
    assert len(reason) <= 300
    assert "\n" not in reason


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"values": np.ones((1, 4, 5))}, "for 3 columns"),
        ({"values": np.ones((2, 4, 4))}, "times have shape"),
        ({"values": np.ones((2, 0, 5))}, "1 to 1024 rollouts"),
        ({"values": np.ones((2, 1025, 5))}, "1 to 1024 rollouts"),
        ({"values": np.where(np.arange(40).reshape(2, 4, 5) == 27, np.nan, 1.0)}, "rollout 1: .* y is nan at t = 0.2"),
        ({"time": np.array([0.0, 0.1, 0.1, 0.3, 0.2])}, "is before"),
        ({"time": np.array([0.0, 0.1, np.inf, 0.3, 0.4])}, "not finite"),
        ({"failures": {4: "x"}}, "by their places"),
        ({"failures": dict.fromkeys(range(4), "x"), "values": np.zeros((2, 4, 5))}, "by their places"),
        ({"failures": {1: "x"}}, "are zeros"),
        ({"columns": ("x", "t", "y")}, "'t' first"),
    ],
)
def test_what_is_no_batch_is_refused(change: dict[str, Any], said: str) -> None:
    keys: dict[str, Any] = {
        "columns": COLUMNS,
        "time": TIMES.copy(),
        "values": np.ones((2, 4, 5)),
        "failures": {},
    } | change
    with pytest.raises(ValueError, match=said):
        Batch(**keys)


def test_a_jump_is_allowed_once() -> None:
    time = np.array([0.0, 0.1, 0.1, 0.1, 0.2])
    Batch(("t", "x"), time.copy(), np.array([[[1.0, 1.0, 1.0, 2.0, 2.0]]]))
    with pytest.raises(ValueError, match="rollout 0"):
        Batch(("t", "x"), time.copy(), np.array([[[1.0, 1.0, 3.0, 2.0, 2.0]]]))


@pytest.mark.parametrize(
    "content",
    [
        {"time_npy": b"x"},
        {"time_npy": to_npy(np.ones((5, 1)))},
        {"trajectory_npy": to_npy(np.ones((8, 5)))},
        {"trajectory_npy": to_npy(np.ones((2, 4, 5)))[:-8]},
        {"trajectory_npy": to_npy(np.ones((2, 4, 5))).replace(b"(2, 4, 5)", b"(4, 2, 5)")},
        {"failures_json": b"[]"},
        {"failures_json": b"{}"},
        {"failures_json": b'[[1.0,"x"]]'},
        {"failures_json": b'[[1,"x"],[1,"x"]]'},
        {"failures_json": b'[[2,"x"],[1,"x"]]'},
        {"failures_json": b'[[1,"x" ]]'},
        {"failures_json": b"[1,2]"},
        {"failures_json": b"\xff"},
    ],
)
def test_what_is_written_otherwise_is_refused(content: dict[str, bytes]) -> None:
    with pytest.raises(TrajectoryError):
        read_batch(a_file(**content))
    assert len(read_batch(a_file()).batch) == 4


def test_an_intact_file_with_a_number_that_is_not_finite_is_no_damage() -> None:
    values = np.ones((2, 4, 5))
    values[1, 2, 3] = np.inf
    with pytest.raises(UnusableTrajectoryError, match=r"rollout 2: samples are not finite: y is inf at t = 0\.3 s"):
        read_batch(a_file(trajectory_npy=to_npy(values)))


@pytest.mark.parametrize("place", range(0, 3000, 97))
def test_no_changed_byte_passes(place: int) -> None:
    file = bytearray(encode_batch(a_batch({1: "diverged"}), request={"a": 1}, metadata={"b": "c"}))
    file[place % len(file)] ^= 1
    with pytest.raises(TrajectoryError):
        read_batch(bytes(file))


def test_a_batch_may_have_as_many_times_as_a_rollout_alone() -> None:
    count = 200_000
    found = a_file(time_npy=to_npy(np.linspace(0.0, 1.0, count)), trajectory_npy=to_npy(np.ones((2, 4, count))))
    assert read_batch(found).batch.values.shape == (2, 4, count)
    with pytest.raises(TrajectoryError, match=r"request\.json has 2097152 bytes"):
        read_batch(a_file(request_json=b" " * 2**21, trajectory_npy=to_npy(np.ones((2, 4, count)))))
