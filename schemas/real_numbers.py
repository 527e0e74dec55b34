"""Real numbers from outside: what a system returns, what is handed in, and arguments; nothing else passes for one.

numpy reads text, bytes, dates and durations as numbers, and drops masks, units and imaginary parts without a word.
"""

import math
from collections.abc import Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import shortened

DEEPEST = 4
"""Levels of lists within lists; no array of perfbound has more than two dimensions."""
_OTHERS = {
    "U": ("text", "read it as numbers first"),
    "S": ("bytes", "read them as numbers first"),
    "M": ("dates", "give seconds since the start of the rollout"),
    "m": ("durations", "give them in the unit of the column: `value / np.timedelta64(1, 's')` is in s"),
    "c": ("complex numbers", "give the real part, or the magnitude"),
    "V": ("records", "give one array for each column"),
}
"""Kinds of dtypes that are no real numbers: what they are, and what to give in their place."""
# Not `np.signedinteger`: durations are among them.
_SIGNED = (np.int8, np.int16, np.int32, np.int64, np.longlong)
_REAL = (bool, int, float, np.bool_, np.unsignedinteger, *_SIGNED, np.floating, Decimal, Fraction)
_GIVE = "give real numbers"


def real_array(value: object) -> NDArray[np.float64]:
    """Return real numbers as float64, of any shape: Python's and numpy's, `Decimal` and `Fraction`; True is 1.

    A number that is too large becomes an infinity, as numpy makes it. A mask without a true entry changes nothing.

    Raises:
        ValueError: "is ..." or "has ...", to follow the name of the value: what it is instead, with the first place.

    >>> real_array([1, 2.5]).tolist(), float(real_array(np.float32(0.5)))
    ([1.0, 2.5], 0.5)
    >>> real_array(["1", "2"])
    Traceback (most recent call last):
        ...
    ValueError: is text ('1' at row 0); read it as numbers first
    >>> real_array(np.ma.masked_greater([[1.0, 2.0], [1.0, 3.0]], 2))
    Traceback (most recent call last):
        ...
    ValueError: has a masked value at row 1, column 1; give a number there, or leave the sample out

    """
    if type(value) is np.ndarray and value.dtype.kind in "fiub":
        return _as_float64(value)
    for place, each in _parts(value):
        _check_dropped(place, each)
    try:
        array = np.asanyarray(value)  # a mask that `__array__` returns stays
        _check_dropped((), array)
        array = np.asarray(array)
    except ValueError as error:
        if str(error).startswith(("has ", "is ")):
            raise
        raise ValueError(f"is {_kind(value)} whose entries differ in length; give one array for each column") from None
    except Exception as error:  # noqa: BLE001  (of whatever `__array__` calls)
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"is {_kind(value)}, of which numpy makes no array ({shortened(reason)}); {_GIVE}") from None
    if array.dtype.kind in _OTHERS:
        what, remedy = _OTHERS[array.dtype.kind]
        place, first = _first_other(value, array)
        raise ValueError(f"is {what} ({shortened(repr(first), 40)}{_at(place)}); {remedy}")
    return _of_objects(array, value) if array.dtype.kind == "O" else _as_float64(array)


def real_number(value: object) -> float:
    """Return one finite real number; see `real_array`.

    Raises:
        ValueError: as of `real_array`, or it is not one number, or not finite.

    >>> real_number(float("nan"))
    Traceback (most recent call last):
        ...
    ValueError: is nan; give a finite number

    """
    array = real_array(value)
    if array.ndim:
        raise ValueError(f"has the shape {array.shape}; give one number")
    if not np.isfinite(array):
        raise ValueError(f"is {float(array)}; give a finite number")
    return float(array)


def _as_float64(array: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):  # of wider floats: an infinity is refused where numbers have to be finite
        return np.asarray(array, dtype=np.float64)


def _parts(value: object, place: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], object]]:
    """Yield a value and what is in its lists, each with its place; lists of numbers alone are not taken apart."""
    yield place, value
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        return
    if len(place) == DEEPEST:
        raise ValueError(f"is lists within lists, more than {DEEPEST} deep; give one array for each column")
    if not all(issubclass(kind, _REAL) for kind in set(map(type, value))):
        for k, each in enumerate(value):
            yield from _parts(each, (*place, k))


def _check_dropped(place: tuple[int, ...], value: object) -> None:
    """Refuse a mask and a unit, which numpy drops, and bytes, which it takes for numbers."""
    if isinstance(value, bytearray) or (isinstance(value, memoryview) and value.format in ("B", "c")):
        raise ValueError(f"is {_kind(value)}{_at(place)}; {_OTHERS['S'][1]}")
    if isinstance(value, np.ma.MaskedArray) and not value.dtype.names:
        mask = np.ma.getmaskarray(value)
        if mask.any():
            first = _place(int(mask.argmax()), mask.shape)
            raise ValueError(f"has a masked value{_at((*place, *first))}; give a number there, or leave the sample out")
    # Quantities of astropy and pint: the number of another unit would pass for one of the column.
    for name in ("unit", "units"):
        if hasattr(type(value), name) and hasattr(type(value), "__array__"):
            unit = shortened(str(getattr(value, name)), 40)
            raise ValueError(f"has the unit {unit!r}{_at(place)}; give plain numbers in the unit of the column")


def _of_objects(array: NDArray[Any], value: object) -> NDArray[np.float64]:
    """Return an array of Python's objects as one of float64."""
    if not array.ndim and not isinstance(array.item(), _REAL):
        raise ValueError(f"is {_kind(value)}; {_GIVE}")
    flat = array.ravel()
    for k, each in enumerate(flat):
        if not isinstance(each, _REAL):
            place = _place(k, array.shape)
            _check_dropped(place, each)
            raise ValueError(f"is {_kind(each)} ({shortened(repr(each), 40)}{_at(place)}); {_GIVE}")
    return np.array([_as_double(each) for each in flat], dtype=np.float64).reshape(array.shape)


def _as_double(number: Any) -> float:
    try:
        return float(number)
    except OverflowError:  # of an int or a fraction
        return math.inf if number > 0 else -math.inf
    except ValueError:  # a signalling NaN of Decimal
        return math.nan


def _first_other(value: object, array: NDArray[Any]) -> tuple[tuple[int, ...], object]:
    """Return the first entry that is no real number with its place: as it was given, else as numpy made it."""
    for place, each in _parts(value) if isinstance(value, Sequence) else ():
        if isinstance(each, str | bytes) or not isinstance(each, (*_REAL, Sequence, np.ndarray)):
            return place, each
    return (0,) * array.ndim, array.flat[0] if array.size else array


def _kind(value: object) -> str:
    return "None" if value is None else type(value).__name__


def _place(flat: int, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(k) for k in np.unravel_index(flat, shape))


def _at(place: tuple[int, ...]) -> str:
    named = zip(("row", "column", "layer"), place, strict=False)
    return " at " + ", ".join(f"{name} {k}" for name, k in named) if place else ""
