"""Sample times of a trajectory, and the samples that belong to an interval.

| symbol | name        | meaning                                                                     | shape | unit |
|--------|-------------|-----------------------------------------------------------------------------|-------|------|
| t_k    | `times`     | sample times, not decreasing; two equal ones are a jump                     | (T,)  | s    |
| [a, b] | `interval`  | seconds from now, of a temporal operator; b may be inf                      |       | s    |
| tau_i  | `slack`     | how far from t_i a border is the same instant, see `schemas.instants`       | (T,)  | s    |
| W_k    | `Windows`   | samples i with t_k + a - tau_i <= t_i <= t_k + b + tau_i                    | (T,)  |      |
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....schemas.instants import reached
from .errors import FormulaError
from .horizon import check_horizon
from .text import excerpt
from .tree import REST, Always, Eventually, Formula, Interval, Temporal, Until, operands, walk

__all__ = ["Grid", "StrictGrid", "Windows"]

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """One run of samples for each sample k: from `first[k]` up to, but without, `stop[k]`; empty if they are equal."""

    first: Indices  # (T,)
    stop: Indices  # (T,)

    def are(self, other: "Windows") -> bool:
        """Whether these are the windows of `other`."""
        return np.array_equal(self.first, other.first) and np.array_equal(self.stop, other.stop)

    def since_now(self) -> "Windows":
        """Return the windows that begin at their own sample and end where these end."""
        return Windows(np.arange(len(self.first)), self.stop)

    def up_to_first(self) -> "Windows":
        """Return the windows from their own sample to the first sample of these, included."""
        return Windows(np.arange(len(self.first)), np.minimum(self.first + 1, len(self.first)))

    @property
    def to_end(self) -> bool:
        """Whether every window ends with the trajectory: then the first one does."""
        return bool(self.stop[0] == len(self.stop))

    def cover(self, read: Flags) -> Flags:
        """Return for every sample if it belongs to the window of some sample that is `read`."""
        size = len(read) + 1
        # A window adds 1 at its first sample and takes it back at its stop: the running sum counts the windows.
        edges = np.bincount(self.first[read], minlength=size) - np.bincount(self.stop[read], minlength=size)
        return np.cumsum(edges[:-1]) > 0


class Grid:
    """The sample times of a trajectory; they are checked only if a formula has an interval."""

    def __init__(self, times: Floats) -> None:
        self._given = times
        self._windows: dict[Interval, Windows] = {}

    def __len__(self) -> int:
        return len(self._given)

    @cached_property
    def _times(self) -> Floats:
        times = self._given
        if not (np.isfinite(times).all() and (np.diff(times) >= 0.0).all()):
            raise ValueError("the sample times must be finite and must not decrease")
        return times

    @cached_property
    def _reached(self) -> tuple[Floats, Floats]:
        """Earliest and latest moment of the instant of each sample."""
        return reached(self._times)

    def windows(self, interval: Interval) -> Windows:
        """Return the samples that belong to `interval` at each sample.

        Raises:
            ValueError: the sample times decrease.

        """
        if interval not in self._windows:
            self._windows[interval] = self._search(interval)
        return self._windows[interval]

    def _search(self, interval: Interval) -> Windows:
        if interval == REST:
            return Windows(np.arange(len(self)), np.full(len(self), len(self)))
        return self._within(interval, *self._reached)

    def _within(self, interval: Interval, earliest: Floats, latest: Floats) -> Windows:
        first = latest.searchsorted(self._times + interval.low, "left")
        stop = earliest.searchsorted(self._times + interval.high, "right")
        return Windows(first, stop)

    def reaches(self, interval: Interval) -> Flags:
        """Return at which samples an interval ends before the trajectory does, shape (T,); one to its end does."""
        if not interval.bounded:
            return np.ones(len(self), dtype=np.bool_)
        found: Flags = self._times + interval.high <= self._reached[1][-1]
        return found

    def check(self, tree: Formula) -> None:
        """Raise if a formula cannot be read at the first sample.

        Raises:
            FormulaError: it reaches beyond the last sample, or an interval contains no sample where it is read.
            ValueError: it has intervals, and the sample times decrease.

        """
        # A formula without intervals compares no times, so that any grid will do.
        if all(node.interval == REST for node in walk(tree) if isinstance(node, Temporal)):
            return
        end = self._times[-1]
        check_horizon(tree, float(end - self._times[0]), slack=float(self._reached[1][-1] - end))
        self._check(tree, np.arange(len(self)) == 0)

    def _check(self, tree: Formula, read: Flags) -> None:
        """Check `tree` where it is `read`."""
        if isinstance(tree, Temporal):
            windows = self.windows(tree.interval)
            empty = np.flatnonzero(read & (windows.first >= windows.stop))
            if empty.size:
                raise FormulaError(
                    f"the interval of `{excerpt(tree)}` contains no sample at t = {self._times[empty[0]]:.9g} s: "
                    "make it at least as long as the time between two samples"
                )
        for operand, there in zip(operands(tree), self._read(tree, read), strict=True):
            self._check(operand, there)

    def _read(self, tree: Formula, read: Flags) -> tuple[Flags, ...]:
        """Return where each operand of `tree` is read."""
        match tree:
            case Always(_, interval) | Eventually(_, interval):
                return (self.windows(interval).cover(read),)
            case Until(_, _, interval, reading):
                windows = self.windows(interval)
                left = windows.since_now() if reading == "standard" else windows
                return left.cover(read), windows.cover(read)
            case _:
                return (read,) * len(operands(tree))


class StrictGrid(Grid):
    """The sample times of a grid with windows by their numbers, without the tolerance around a stamp.

    Where such a window would have no sample it is that of the grid: there is no other reading.
    """

    def __init__(self, grid: Grid) -> None:
        super().__init__(grid._given)
        self._tolerant = grid

    def _search(self, interval: Interval) -> Windows:
        found = self._tolerant.windows(interval)
        if interval == REST:
            return found
        strict = self._within(interval, *self._reached)
        there = strict.first < strict.stop
        return Windows(np.where(there, strict.first, found.first), np.where(there, strict.stop, found.stop))

    @cached_property
    def _reached(self) -> tuple[Floats, Floats]:
        return reached(self._times, strict=True)
