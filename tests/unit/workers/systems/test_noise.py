"""Random numbers of many rollouts: the published algorithm, and each row from its own seed."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import perfbound as pb
from perfbound.schemas.draws.counter import _philox
from perfbound.workers.systems import noise

ANSWERS = [
    ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
    ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
    (
        [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
        [0xA4093822, 0x299F31D0],
        [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
    ),
]
"""(counter, key, words) of Random123, kat_vectors."""
SEEDS = st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=5)


@pytest.mark.parametrize(("counter", "key", "words"), ANSWERS)
def test_it_is_the_published_generator(counter: list[int], key: list[int], words: list[int]) -> None:
    c0, c1, c2, c3 = (np.full((1, 1), each, dtype=np.uint64) for each in counter)
    k0, k1 = (np.array([each], dtype=np.uint64) for each in key)
    assert [int(each[0, 0]) for each in _philox((c0, c1, c2, c3), (k0, k1))] == words


@given(SEEDS, st.integers(0, 9), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_a_row_follows_from_its_seed_alone(seeds: list[int], count: int, more: int, stream: int) -> None:
    every = pb.uniform(np.array(seeds, dtype=np.uint64), count + more, stream=stream)
    assert every.shape == (len(seeds), count + more)
    assert ((every >= 0.0) & (every < 1.0)).all()
    for row, seed in zip(every, seeds, strict=True):
        alone = pb.uniform(np.array([seed], dtype=np.uint64), count, stream=stream)[0]
        assert alone.tolist() == row[:count].tolist()


def test_batches_larger_than_what_is_computed_at_once_are_the_same() -> None:
    seeds = np.arange(300, dtype=np.uint64) << np.uint64(40)
    every = pb.uniform(seeds, 101)
    assert every[7:9].tolist() == pb.uniform(seeds[7:9], 101).tolist()
    assert len(np.unique(every)) == every.size


def test_the_numbers_have_their_distributions() -> None:
    seeds = np.arange(400)
    each = pb.uniform(seeds, 250)
    assert stats.kstest(each.ravel(), "uniform").pvalue > 0.001
    assert stats.kstest(each[:, 0], "uniform").pvalue > 0.001
    assert stats.kstest(pb.normal(seeds, 250).ravel(), "norm").pvalue > 0.001
    others = pb.uniform(seeds, 250, stream=1)
    normal = pb.normal(seeds, 250)
    pairs = [(each[:-1], each[1:]), (each[:, :-1], each[:, 1:]), (each, others), (normal[:, :-1], normal[:, 1:])]
    assert all(abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.015 for a, b in pairs)


@given(SEEDS, st.integers(0, 9), st.integers(0, 9))
def test_a_row_of_normal_numbers_follows_from_its_seed_alone(seeds: list[int], count: int, more: int) -> None:
    every = pb.normal(np.array(seeds, dtype=np.uint64), count + more)
    for row, seed in zip(every, seeds, strict=True):
        assert pb.normal(np.array([seed], dtype=np.uint64), count)[0].tolist() == row[:count].tolist()


def test_normal_numbers_are_finite_at_both_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = [0.0, 1.0 - 2.0**-53]
    monkeypatch.setattr(noise, "uniform", lambda *_, **__: np.array([[a, b] for a in ends for b in ends]))
    assert np.isfinite(pb.normal([1, 2, 3, 4], 2)).all()


@pytest.mark.parametrize("seeds", [[-1], [0.5], [[1]]])
def test_what_is_no_seed_is_refused(seeds: Any) -> None:
    with pytest.raises(ValueError, match="seeds must be unsigned whole numbers of 64 bits"):
        pb.uniform(seeds, 1)


def test_a_stream_or_a_count_outside_its_range_is_refused() -> None:
    with pytest.raises(ValueError, match="stream must be a whole number of 32 bits, not -1"):
        pb.uniform([1], 1, stream=-1)
    with pytest.raises(ValueError, match="count must not be negative, not -1"):
        pb.normal([1], -1)
