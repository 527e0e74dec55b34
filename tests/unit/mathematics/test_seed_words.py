"""The seeds of a batch: to the bit those of numpy's `SeedSequence`."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.seed_words import first_states

WORD = st.integers(0, 2**32 - 1)


@given(
    st.lists(st.integers(0, 2**256), min_size=1, max_size=3),
    st.lists(WORD, max_size=3),
    st.lists(st.tuples(WORD, WORD), min_size=1, max_size=5),
)
def test_it_is_what_numpy_generates(entropy: list[int], keys: list[int], last: list[tuple[int, int]]) -> None:
    found = first_states(entropy, keys, [np.array(column, dtype=np.uint32) for column in zip(*last, strict=True)])
    wanted = [
        np.random.SeedSequence(entropy, spawn_key=(*keys, *each)).generate_state(1, np.uint64)[0] for each in last
    ]
    assert found.tolist() == wanted
