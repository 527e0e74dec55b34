"""The same instant: when a stamp of a trajectory is a border of a window, the horizon, or another stamp.

| symbol | name    | meaning                                                                     | shape | unit |
|--------|---------|-----------------------------------------------------------------------------|-------|------|
| t_k    | `times` | stamps of a trajectory, not decreasing; two equal ones are a jump           | (T,)  | s    |
| tau_k  |         | how far from t_k a moment is still the same instant                         | (T,)  | s    |

Simulators give stamps that are exact, rounded to float32, or sums of a step with its round-off, and a border of 0.3 s
must take in the sample that is meant to be there. tau_k is a hundredth of the shorter step at t_k, and at least the
resolution of float32 there, unless the stamps around are closer together than that: then they are no float32.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .values import Stamps

Floats = NDArray[np.float64]

SHARE = 0.01
"""Of the local step, by which a stamp may miss a border."""
SAMPLES = 50
"""The last stamp may precede the horizon by one step, but by no more than the horizon divided by this."""
FLOAT32 = 2.0**-23
"""Relative resolution of float32: neighbours at t differ by at most t times this."""
STRICT = 1e-9, 2.0**-49
"""Share and relative resolution of numbers that are equal but for how they are written: 0.1 s three times is 0.3 s."""


def slack(times: Floats, share: float = SHARE, relative: float = FLOAT32) -> Floats:
    """Return how far from each stamp (T,) in s a moment is still the same instant, shape (T,).

    >>> slack(np.array([0.0, 0.1, 0.2])).tolist()
    [0.001, 0.001, 0.001]
    """
    steps = np.diff(times)
    steps = steps[steps > 0.0]  # the two stamps of a jump are one instant
    if not len(steps):
        return np.full(len(times), abs(times[-1]) * relative if len(times) else 0.0)
    # Number of the instant that a stamp belongs to; an instant at an end has one neighbour.
    instant = np.concatenate(([0], np.cumsum(np.diff(times) > 0.0)))
    before, after = np.concatenate((steps[:1], steps))[instant], np.concatenate((steps, steps[-1:]))[instant]
    resolution = np.abs(times) * relative
    # An event a hair after a sample has a long step on its other side; a grid finer than float32 has none.
    resolution = np.where(np.maximum(before, after) > resolution, resolution, 0.0)
    found: Floats = np.maximum(share * np.minimum(before, after), resolution)
    return found


def reached(times: Floats, *, strict: bool = False) -> tuple[Floats, Floats]:
    """Return the earliest and the latest moment of each stamp's instant, both not decreasing, shapes (T,).

    A window [a, b] has the samples with latest >= a and earliest <= b. A `strict` instant is the number alone.
    """
    around = slack(times)
    if strict:
        around = np.minimum(around, slack(times, *STRICT))
    # Where stamps are closer than their slack, the run of samples in a window has no gap all the same.
    earliest = np.minimum.accumulate((times - around)[::-1])[::-1]
    return earliest, np.maximum.accumulate(times + around)


def apart(one: float, other: float) -> tuple[str, str]:
    """Return two different times as texts that differ.

    >>> apart(2.0, 2.0000002384), apart(0.5, 1.0)
    (('2', '2.0000002'), ('0.5', '1'))
    """
    for digits in range(6, 18):
        texts = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return texts


def disorder(samples: Floats) -> str | None:
    """Return what is wrong with the order of rows (T, n), the time first, with row, stamp and remedy; None if nothing.

    Rows of one time are a jump: the state before it and the state after it, each once or several times.

    >>> disorder(np.array([[0.0, 1.0], [0.2, 1.0], [0.1, 1.0]]))
    't = 0.1 s in row 2 is before t = 0.2 s in row 1; the time must not decrease: sort the rows, or fix the clock'
    >>> disorder(np.array([[0.0, 1.0], [0.1, 1.0], [0.1, 2.0], [0.2, 2.0]]))
    """
    times = samples[:, 0]
    if times[0] < 0.0:
        return f"t = {times[0]:.9g} s in row 0 is before the start; the time must begin at 0: subtract the first stamp"
    steps = np.diff(times)
    if (steps < 0.0).any():
        row = int(np.argmax(steps < 0.0)) + 1
        later, earlier = apart(times[row - 1], times[row])
        return (
            f"t = {earlier} s in row {row} is before t = {later} s in row {row - 1}; the time must not decrease: "
            "sort the rows, or fix the clock"
        )
    if (steps > 0.0).all():
        return None
    # Within an instant the state may change once.
    changed = (steps == 0.0) & (np.diff(samples, axis=0) != 0.0).any(axis=1)
    so_far = np.cumsum(changed)
    begin = np.maximum.accumulate(np.where(steps > 0.0, so_far, 0))
    thrice = changed & (so_far - begin > 1)
    if thrice.any():
        row = int(np.argmax(thrice)) + 1
        return (
            f"t = {times[row]:.9g} s has a third state in row {row}; a jump has two, that before and that after it: "
            "leave out those between"
        )
    return None


def ends_early(times: Floats, horizon: float) -> bool:
    """Whether stamps (T,) end so long before `horizon` s that they do not cover it, see `uncovered`.

    >>> ends_early(np.arange(80) * 0.1, 8.0), ends_early(np.arange(70) * 0.1, 8.0), ends_early(np.zeros(1), 0.0)
    (False, True, False)
    """
    return bool(times[-1] < horizon - _allowed(times, horizon) - slack(times)[-1])


def _allowed(times: Floats, horizon: float) -> float:
    """Return by how much the last stamp may precede the horizon: one step, but no more than a part of the horizon."""
    return min(float(np.max(np.diff(times), initial=0.0)), horizon / SAMPLES)


def uncovered(times: Floats, horizon: float) -> str | None:
    """Return what is wrong with the ends of stamps (T,) that are to cover 0 to `horizon` s; None if nothing is.

    The last one may precede the horizon by one step, but by no more than the horizon divided by `SAMPLES`: one that
    starts late or ends early would be scored on a part of what the specification covers.

    >>> uncovered(np.arange(80) * 0.1, 8.0), uncovered(np.array([0.0, 1.0, 2.0000002]), 2.0)
    (None, None)
    >>> uncovered(np.array([0.1, 8.0]), 8.0)
    'the first row is at t = 0.1 s, and 0 s is requested: begin with the state at the start'
    """
    return _uncovered(np.asarray(times, dtype=np.float64).tobytes(), horizon)


@lru_cache(maxsize=4)  # most rollouts of a system have one grid
def _uncovered(stamps: bytes, horizon: float) -> str | None:
    times = np.frombuffer(stamps)
    around, row = slack(times), len(times) - 1
    first, last = float(times[0]), float(times[-1])
    if first > max(around[0], 0.0):
        return f"the first row is at t = {first:.9g} s, and 0 s is requested: " + (
            "subtract the time at the start" if first > horizon > 0.0 else "begin with the state at the start"
        )
    if last == 0.0 and horizon > around[-1]:
        return (
            f"the rollout is one sample at 0 s, and the horizon is {horizon:.9g} s: where rollouts last, give "
            "one of at least a step; where they are one sample, remove `horizon` from the file"
        )
    end, there = apart(horizon, last)
    if last > horizon + around[-1]:
        milliseconds = horizon > 0.0 and abs(last / 1000.0 - horizon) <= horizon / SAMPLES
        remedy = "give seconds, not milliseconds" if milliseconds else "end at the horizon, in seconds"
        if not horizon:
            remedy = f"give the campaign horizon = {there}, or return one sample alone"
        return f"the last row, {row}, is at t = {there} s, and the horizon is {end} s: {remedy}"
    if ends_early(times, horizon):
        if step := _other_step(times, horizon):
            return f"{step}; the last row, {row}, is at t = {there} s, and the horizon is {end} s"
        return (
            f"the last row, {row}, is at t = {there} s, and the horizon is {end} s, before which it may be by "
            f"{_allowed(times, horizon):.3g} s: simulate to the horizon{_one_more(times, horizon)}, or "
            "declare what an early end means: after_end "
            '= "hold" (the last state stays) or "fail" (it violates the specification)'
        )
    return None


def _one_more(times: Floats, horizon: float) -> str:
    """Return that the sample at the horizon alone is missing, if so: int(horizon / step) of them are one too few."""
    steps = np.append(np.diff(times), horizon - times[-1])
    one = len(steps) > 1 and float(np.ptp(steps)) <= SHARE * float(steps.min())
    return ", with one sample more: round(horizon / step) + 1" if one else ""


def _other_step(times: Floats, horizon: float) -> str:
    """Return which step the samples seem to have: one that covers the horizon, where it is a multiple of their own."""
    steps = np.diff(times)
    if not len(steps) or float(np.ptp(steps)) > SHARE * float(steps.min()):
        return ""
    meant, samples = float(f"{horizon / len(steps):.3g}"), len(times)
    own = float(steps[0])
    # A model that records every second sample; any other factor is that of a rollout that ends early.
    several = abs(meant / own - round(meant / own)) <= SHARE and round(meant / own) > 1
    if not several or abs(meant * len(steps) - horizon) > STRICT[0] * horizon:
        return ""
    return (
        f"{samples} samples are {horizon:g} s in steps of {meant:g} s, not of {own:.3g} s: correct the step, or return "
        f"{round(horizon / own) + 1} samples"
    )


def stamps(times: Floats) -> Stamps:
    """Return of what kind stamps (T,) in equal steps are; those in other steps are what the simulator says, and exact.

    >>> grid = np.arange(2000) * 0.01
    >>> stamps(grid), stamps(grid.astype(np.float32).astype(np.float64)), stamps(np.cumsum(np.full(2000, 0.01)) - 0.01)
    ('exact', 'float32', 'accumulated')
    """
    if len(times) < 3:
        return "exact"
    mean, end = float(times[-1] - times[0]) / (len(times) - 1), float(abs(times[-1]))
    # A step of few digits, as people write it, or any: 1/240 s has no end.
    number = np.arange(len(times))
    steps = float(f"{mean:.6g}"), mean
    missed, step = min((float(np.abs(times - times[0] - number * each).max()), each) for each in steps)
    if missed <= 4 * np.finfo(np.float64).eps * end or missed > SHARE * step:
        return "exact"
    rounded = missed <= end * FLOAT32 and bool((times.astype(np.float32) == times).all())
    return "float32" if rounded else "accumulated"
