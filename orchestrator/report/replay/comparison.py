"""How far a trajectory is from the recorded one of the same request."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ....schemas.trajectory import Trajectory

SAME = 1e-9
"""Largest difference, in the unit of the column, that another machine is allowed: CPUs round differently."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest difference in one column, and when it occurs: unit of the column, s."""

    column: str
    largest: float
    at: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two trajectories side by side; `grids` says what is wrong with the times, and then nothing else is compared."""

    bitwise: bool
    differences: tuple[Difference, ...] = ()
    grids: str = ""

    @property
    def worst(self) -> Difference | None:
        """The column that differs most."""
        return max(self.differences, key=lambda each: each.largest, default=None)

    @property
    def same(self) -> bool:
        """Whether no number differs by more than `SAME`."""
        return self.bitwise or (not self.grids and self.worst is not None and self.worst.largest <= SAME)


def compare(again: Trajectory, before: Trajectory) -> Comparison:
    """Compare what was simulated now with what is recorded."""
    if again.columns != before.columns:
        return Comparison(bitwise=False, grids=f"the columns are {', '.join(again.columns)} now")
    if again.samples.shape != before.samples.shape:
        return Comparison(bitwise=False, grids=f"there are {len(again.samples)} samples, not {len(before.samples)}")
    if again.samples.tobytes() == before.samples.tobytes():
        return Comparison(bitwise=True)
    gaps = np.abs(again.samples - before.samples)  # (T, n)
    rows = gaps.argmax(axis=0)
    times = before.samples[rows, 0]
    found = zip(before.columns, gaps.max(axis=0).tolist(), times.tolist(), strict=True)
    return Comparison(bitwise=False, differences=tuple(Difference(*each) for each in found))


def lines(comparison: Comparison, units: Mapping[str, str]) -> Iterator[str]:
    """Yield what a person should know; `units` names the unit of every column."""
    if comparison.bitwise:
        yield "bitwise the same as the recorded trajectory"
        return
    if comparison.grids:
        yield f"cannot be compared with the recorded trajectory: {comparison.grids}"
        return
    yield f"{'column':<14} {'unit':<8} {'largest difference':>18} {'at t / s':>9}"
    for each in comparison.differences:
        yield f"{each.column:<14} {units[each.column]:<8} {each.largest:18.3g} {each.at:9.3f}"
