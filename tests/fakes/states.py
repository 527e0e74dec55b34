"""The whole state of an object, to compare two of them to the bit, and blocks of a sequence."""

import math
from array import array
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np


def state_of(value: Any) -> Any:
    """Return all numbers that an object keeps, as objects without identity; functions are left out."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if isinstance(value, array):
        return value.tobytes()
    if isinstance(value, bool | np.bool_ | int | float | np.generic):
        return repr(value.item() if isinstance(value, np.generic) else value)
    if isinstance(value, list | tuple):
        return [state_of(each) for each in value]
    if isinstance(value, dict):
        return {repr(key): state_of(each) for key, each in value.items()}
    if callable(value) or value is None or isinstance(value, str):
        return repr(value) if isinstance(value, str) else None
    slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    names = [*getattr(value, "__dict__", {}), *slots]
    return {name: state_of(getattr(value, name)) for name in names if hasattr(value, name) and "__" not in name}


def blocks(count: int, sizes: Iterable[int]) -> Iterator[slice]:
    """Yield slices of these sizes that cover `count` places; the last one has all that are left."""
    begin, left = 0, iter(sizes)
    while begin < count:
        end = min(begin + next(left, count), count)
        yield slice(begin, end)
        begin = end


def sizes(count: int, seed: int) -> list[int]:
    """Return sizes of blocks from one test to several hundred, for `count` tests or more."""
    rng = np.random.default_rng(seed)
    return [math.floor(each) for each in 10.0 ** rng.uniform(0, 2.8, count)]
