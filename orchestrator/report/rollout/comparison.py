"""The comparison of a trajectory with the recorded one of the same request."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ....schemas.trajectory.trajectory import Trajectory

TOLERANCE = 1e-9
"""Largest difference, in the unit of the column, allowed to another machine: its CPU may round differently."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest difference in one column, and its time: unit of the column, s."""

    column: str
    largest: float
    at: float


@dataclass(frozen=True, slots=True)
class Deviation:
    """The deviation of a trajectory from the recorded one; `mismatch` is the reason why there are no differences."""

    bitwise: bool
    differences: tuple[Difference, ...] = ()
    mismatch: str = ""

    @property
    def worst(self) -> Difference | None:
        """The column that differs most."""
        return max(self.differences, key=lambda each: each.largest, default=None)

    @property
    def within_tolerance(self) -> bool:
        """Whether no number differs by more than `TOLERANCE`."""
        return self.bitwise or (self.worst is not None and self.worst.largest <= TOLERANCE)


def compare(again: Trajectory, recorded: Trajectory) -> Deviation:
    """Compare a new trajectory with the recorded one."""
    if again.columns != recorded.columns:
        return Deviation(bitwise=False, mismatch=f"the columns are {', '.join(again.columns)} now")
    if again.samples.shape != recorded.samples.shape:
        return Deviation(bitwise=False, mismatch=f"there are {len(again.samples)} samples, not {len(recorded.samples)}")
    if again.samples.tobytes() == recorded.samples.tobytes():
        return Deviation(bitwise=True)
    gaps = np.abs(again.samples - recorded.samples)  # (T, n)
    times = recorded.samples[gaps.argmax(axis=0), 0]
    found = zip(recorded.columns, gaps.max(axis=0).tolist(), times.tolist(), strict=True)
    return Deviation(bitwise=False, differences=tuple(Difference(*each) for each in found))


def lines(deviation: Deviation, units: Mapping[str, str]) -> Iterator[str]:
    """Yield the comparison as text; `units` names the unit of every column."""
    if deviation.bitwise:
        yield "bitwise the same as the recorded trajectory"
        return
    if deviation.mismatch:
        yield f"cannot be compared with the recorded trajectory: {deviation.mismatch}"
        return
    yield f"{'column':<14} {'unit':<8} {'largest difference':>18} {'at t / s':>9}"
    for each in deviation.differences:
        yield f"{each.column:<14} {units[each.column]:<8} {each.largest:18.3g} {each.at:9.3f}"
