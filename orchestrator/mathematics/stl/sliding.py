"""Minimum, maximum and until over a run of samples for each sample, all runs at once.

| symbol | name      | meaning                                                  | shape          |
|--------|-----------|----------------------------------------------------------|----------------|
| W_k    | `windows` | the run of sample k, from first[k] to before stop[k]      | (T,)           |
|        | `values`  | a signal (T,), or those of several rollouts              | (..., T)       |
| p      | `span`    | length of the blocks of one level: 1, 2, 4, ...          |                |
|        | `blocks`  | the join of samples i to i + p - 1                       | (..., T-p+1)   |

A run of p <= n < 2p samples is the union of two blocks of p samples: its first and its last. Each level joins two
blocks of the level below, so that all runs cost O(T log n) in numpy and O(T) memory, whatever the sample times. min
and max are exact: the result is one of the values, to the last bit.

`take` gathers, not an index: of several signals an index would put the samples of one far apart in memory.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .grid import Windows

__all__ = ["maximum", "minimum", "until"]

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Join = Callable[[Floats, Floats], Floats]


def minimum(values: Floats, windows: Windows) -> Floats:
    """Return the smallest of `values` (..., T) in each window, same shape; inf in an empty one."""
    return _filled(_extremum(np.minimum, values, windows), windows, np.inf)


def maximum(values: Floats, windows: Windows) -> Floats:
    """Return the largest of `values` (..., T) in each window, same shape; -inf in an empty one."""
    return _filled(_extremum(np.maximum, values, windows), windows, -np.inf)


def until(left: Floats, right: Floats, windows: Windows) -> Floats:
    """Return the largest over i in each window of min(right_i, min of left from the window's first sample to i).

    It is -inf in an empty window. Block: (that number, min of left). Two blocks A, B that overlap or
    touch join to (max(A_0, min(A_1, B_0)), min(A_1, B_1)): for an i in both, B's term is at most A's.
    """
    largest: Floats = _join_windows(_join_until, np.stack([np.minimum(left, right), left]), windows)[0]
    return _filled(largest, windows, -np.inf)


def _extremum(extremum: np.ufunc, values: Floats, windows: Windows) -> Floats:
    # Windows that all end, or begin, with the trajectory need one running extremum from there.
    if windows.to_end:
        rest: Floats = extremum.accumulate(values[..., ::-1], axis=-1)[..., ::-1]
        return _gather(rest, windows.first)
    if windows.from_start:
        return _gather(extremum.accumulate(values, axis=-1), np.maximum(windows.stop - 1, 0))
    return _join_windows(extremum, values, windows)


def _filled(found: Floats, windows: Windows, value: float) -> Floats:
    """Return `found` with the extremum of no value in the place of every empty window."""
    if windows.any_empty:
        found[..., windows.empty] = value
    return found


def _run(samples: Indices) -> Indices | slice:
    """Return increasing `samples` as a slice where no sample is between them, as on a uniform grid: it is faster."""
    first, last = int(samples[0]), int(samples[-1])
    return slice(first, last + 1) if last - first + 1 == len(samples) else samples


def _gather(values: Floats, samples: Indices) -> Floats:
    """Return the values (..., T) at `samples`; the last value for one beyond them."""
    found: Floats = values.take(samples, axis=-1, mode="clip")
    return found


def _join_until(a: Floats, b: Floats) -> Floats:
    return np.stack([np.maximum(a[0], np.minimum(a[1], b[0])), np.minimum(a[1], b[1])])


def _join_windows(join: Join, blocks: Floats, windows: Windows) -> Floats:
    """Return the join of the blocks (..., T) of single samples over each window; `join` may count a sample twice."""
    last = blocks.shape[-1] - 1
    first = np.minimum(windows.first, last)
    stop = np.maximum(windows.stop, first + 1)
    length = stop - first
    result = _gather(blocks, first)
    span, longest = 1, int(length.max())
    while 2 * span <= longest:
        blocks = join(blocks[..., :-span], blocks[..., span:])
        span *= 2
        # Exactly one level has span <= length < 2 span, where two blocks cover the window.
        here = np.flatnonzero((span <= length) & (length < 2 * span))
        if here.size:
            result[..., _run(here)] = join(_gather(blocks, first[here]), _gather(blocks, stop[here] - span))
    return result
