"""The seeds of many rollouts at once: what numpy's `SeedSequence` gives for each spawn key, without an object for each.

The algorithm is part of numpy's promise that equal seeds give equal streams; tests compare the two.

| symbol | meaning |
|---|---|
| pool | four words of 32 bits, into which every word of entropy is mixed |
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint32]

_POOL = 4
_BITS = 32
_MASK = 0xFFFFFFFF
_INIT_A, _MULTIPLIER_A = 0x43B0D7E5, 0x931E8875
_INIT_B, _MULTIPLIER_B = 0x8B51F9DD, 0x58F38DED
_MIX_LEFT, _MIX_RIGHT = 0xCA01F9DD, 0x4973F715
_SHIFT = 16


def first_states(entropy: Sequence[int], keys: Sequence[int], last: Sequence[Words]) -> NDArray[np.uint64]:
    """Return `SeedSequence(entropy, spawn_key=(*keys, *last)).generate_state(1, uint64)` for arrays `last` of keys.

    The keys are below 2^32, and so are the words in each array of `last`, shape (R,).
    """
    words = [word for number in entropy for word in _words(number)]
    words += [0] * (_POOL - len(words))
    words += keys
    shape = last[0].shape
    pool = [np.zeros(shape, dtype=np.uint32) for _ in range(_POOL)]
    # Every constant of the hash follows from the number of words before it.
    hashed = _Hash()
    for place in range(_POOL):
        pool[place] = hashed.of(np.full(shape, words[place], dtype=np.uint32))
    for source in range(_POOL):
        for place in range(_POOL):
            if source != place:
                pool[place] = _mixed(pool[place], hashed.of(pool[source]))
    for word in (*(np.full(shape, each, dtype=np.uint32) for each in words[_POOL:]), *last):
        for place in range(_POOL):
            pool[place] = _mixed(pool[place], hashed.of(word))
    low, high = _generated(pool)
    found: NDArray[np.uint64] = low.astype(np.uint64) | (high.astype(np.uint64) << np.uint64(_BITS))
    return found


def _words(number: int) -> list[int]:
    """Return a number in words of 32 bits, the lowest first; 0 is one word."""
    found = [number & _MASK]
    while number := number >> _BITS:
        found.append(number & _MASK)
    return found


class _Hash:
    """The hash of one word after the other, with a constant that changes each time."""

    def __init__(self) -> None:
        self._constant = _INIT_A

    def of(self, words: Words) -> Words:
        """Return the hash of the next word, of each rollout its own."""
        found = words ^ np.uint32(self._constant)
        self._constant = self._constant * _MULTIPLIER_A & _MASK
        return _folded(found * np.uint32(self._constant))


def _mixed(x: Words, y: Words) -> Words:
    return _folded(x * np.uint32(_MIX_LEFT) - y * np.uint32(_MIX_RIGHT))


def _folded(words: Words) -> Words:
    found: Words = words ^ (words >> np.uint32(_SHIFT))
    return found


def _generated(pool: Sequence[Words]) -> list[Words]:
    """Return the first two words of the state."""
    found, constant = [], _INIT_B
    for words in pool[:2]:
        each = words ^ np.uint32(constant)
        constant = constant * _MULTIPLIER_B & _MASK
        found.append(_folded(each * np.uint32(constant)))
    return found
