"""A reduced batch and its file: the content comes back, and nothing else passes for one."""

import json
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.errors import TrajectoryError
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.trajectory.batch import Batch, digest_of, encode_batch, read_batch
from perfbound.schemas.trajectory.canonical import (
    DIGESTS,
    EVIDENCE,
    KEPT,
    OF_REDUCED,
    REQUEST,
    SCORES,
    TIME,
    canonical_file,
)
from perfbound.schemas.trajectory.npy import to_npy
from perfbound.schemas.trajectory.reduced import Reduced, Scores, encode_reduced, read_reduced, read_stored, reduced
from tests.unit.schemas.trajectory.test_batch import COLUMNS, TIMES, a_batch


def scores(failures: dict[int, str] | None = None) -> Scores:
    robustness = np.array([0.5, -0.25, 0.125, -1.0])
    robustness[list(failures or {})] = np.nan
    marks, ends = np.array([False, True, False, False]), np.array([np.nan, np.nan, 0.2, np.nan])
    return Scores(robustness, marks, ends, failures or {})


def a_reduced(kept: list[int], failures: dict[int, str] | None = None) -> Reduced:
    return reduced(a_batch(failures), kept, scores(failures))


@pytest.mark.parametrize("kept", [[], [1], [1, 3], [0, 1, 3]])
@pytest.mark.parametrize("failures", [{}, {2: "diverged"}])
def test_its_file_has_the_whole_content(kept: list[int], failures: dict[int, str]) -> None:
    whole = a_batch(failures)
    file = read_reduced(encode_reduced(a_reduced(kept, failures), request={"a": 1}, metadata={"first": "p.0.true.0"}))
    found = file.batch
    assert (file.request, file.metadata["first"]) == (b'{"a":1}', "p.0.true.0")
    assert (found.kept, found.failures, found.columns) == (tuple(kept), failures, COLUMNS)
    assert np.array_equal(found.values, whole.values[:, kept])
    assert list(found.digests) == list(whole.digests)
    assert np.array_equal(found.scores.rows, scores(failures).rows, equal_nan=True)


def test_a_rollout_that_is_kept_is_the_one_of_the_whole_batch() -> None:
    found = a_reduced([1, 3], {2: "diverged"})
    for place in (1, 3):
        assert np.array_equal(found.trajectory(place).samples, a_batch().trajectory(place).samples)
    for place, said in ((0, "not kept"), (2, "diverged")):
        with pytest.raises(KeyError, match=said):
            found.trajectory(place)


def test_a_file_is_read_as_what_it_is() -> None:
    whole = encode_batch(a_batch(), request={}, metadata={})
    part = encode_reduced(a_reduced([1]), request={}, metadata={})
    assert isinstance(read_stored(whole).batch, Batch)
    assert isinstance(read_stored(part).batch, Reduced)
    with pytest.raises(TrajectoryError):
        read_batch(part)
    with pytest.raises(TrajectoryError):
        read_reduced(whole)


def test_a_digest_of_one_rollout_is_the_one_in_its_batch() -> None:
    digests = list(a_batch().digests)
    assert [digest_of(a_batch().trajectory(place)) for place in range(4)] == digests
    negative = Batch(("t", "x"), np.array([0.0]), np.array([[[-0.0], [0.0]]]))
    assert len(set(negative.digests)) == 2, "-0.0 and 0.0 are equal numbers, and not the same result"


def test_a_reduced_rollout_is_said_to_be_reduced() -> None:
    request = {
        "campaign": "c",
        "config_sha256": "0" * 64,
        "problem": "p",
        "test": 0,
        "variant": "true",
        "replicate": 0,
        "replicates": 1,
        "seeds": [1, 2, 3, 4],
        "system": "s",
        "spec_sha256": "0" * 64,
        "x": [[0], [1], [2], [3]],
        "horizon": 0.4,
    }
    file = read_reduced(encode_reduced(a_reduced([1]), request=request, metadata={}))
    assert np.array_equal(file.alone(RolloutId("p", 1, "true", 0)).trajectory.samples, a_batch().trajectory(1).samples)
    with pytest.raises(TrajectoryError, match=r"p\.3\.true\.0 .* samples were not kept"):
        file.alone(RolloutId("p", 3, "true", 0))


def a_file(**content: bytes) -> bytes:
    whole = a_reduced([1])
    found = {
        REQUEST: b"{}",
        TIME: to_npy(TIMES.copy()),
        KEPT: b"[1]",
        EVIDENCE: to_npy(whole.values),
        DIGESTS: whole.digest_column,
        SCORES: to_npy(whole.scores.rows),
        **{name.replace("_", "."): each for name, each in content.items()},
    }
    return canonical_file(OF_REDUCED, {"columns": json.dumps(COLUMNS)}, found)


DIGEST = a_reduced([1]).digest_column
TABLE = scores().rows


def table(row: int, place: int, value: float) -> bytes:
    changed = TABLE.copy()
    changed[row, place] = value
    return to_npy(changed)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"kept_json": b"[0]"}, "samples of rollout 0 have another digest"),
        ({"kept_json": b"[4]"}, "not rollouts of the batch"),
        ({"kept_json": b"[-1]"}, "not rollouts of the batch"),
        ({"kept_json": b"[1,2]"}, "2 kept rollouts"),
        ({"kept_json": b"[1,1]"}, "2 kept rollouts"),
        ({"kept_json": b"[]"}, "0 kept rollouts"),
        ({"kept_json": b"[1.0]"}, "no list of places"),
        ({"kept_json": b"[true]"}, "no list of places"),
        ({"kept_json": b"[1 ]"}, "not written as"),
        ({"kept_json": b"{}"}, "no list of places"),
        ({"kept_json": b"\xff"}, "UnicodeDecodeError"),
        ({"kept_json": b"[" * 100_000}, "RecursionError"),
        ({"digests_bin": DIGEST[:-1]}, "with a digest"),
        ({"digests_bin": DIGEST + bytes(32)}, "with a digest"),
        ({"digests_bin": bytes(32) + DIGEST[32:]}, "no digest"),
        ({"digests_bin": DIGEST[:32] + bytes([1] * 32) + DIGEST[64:]}, "rollout 1 have another digest"),
        ({"scores_npy": table(0, 2, np.nan)}, "no robustness"),
        ({"scores_npy": table(0, 2, np.inf)}, "no robustness"),
        ({"scores_npy": table(1, 2, 0.5)}, "other rows"),
        ({"scores_npy": table(1, 2, np.nan)}, "other rows"),
        ({"scores_npy": to_npy(TABLE[:2])}, "other rows"),
        ({"scores_npy": to_npy(np.ones((3, 0)))}, "1 to 1024 rollouts"),
        ({"scores_npy": to_npy(np.ones((3, 1025)))}, "1 to 1024 rollouts"),
        ({"trajectory_npy": to_npy(np.ones((2, 1, 4)))}, "for 3 columns"),
        ({"failures_json": b'[[1,"x"]]'}, "one of them is both"),
        ({"failures_json": b'[[2,"x"]]'}, "a failed one has"),
        ({"failures_json": b"[]"}, "not written as"),
    ],
)
def test_what_is_written_otherwise_is_refused(content: dict[str, Any], said: str) -> None:
    with pytest.raises(TrajectoryError, match=said):
        read_reduced(a_file(**content))
    assert len(read_reduced(a_file()).batch) == 4


@pytest.mark.parametrize("place", range(0, 3000, 97))
def test_no_changed_byte_passes(place: int) -> None:
    file = bytearray(encode_reduced(a_reduced([0, 3], {2: "diverged"}), request={"a": 1}, metadata={"b": "c"}))
    file[place % len(file)] ^= 1
    with pytest.raises(TrajectoryError):
        read_reduced(bytes(file))
