"""Sample times of a trajectory, and the samples that belong to an interval.

| symbol | name        | meaning                                                                     | shape | unit |
|--------|-------------|-----------------------------------------------------------------------------|-------|------|
| t_k    | `times`     | sample times, not decreasing; two equal ones are a jump                     | (T,)  | s    |
| [a, b] | `interval`  | seconds from now, of a temporal operator; b may be inf                      |       | s    |
| tau_i  | `slack`     | how far from t_i a border is the same instant, see `schemas.instants`       | (T,)  | s    |
| W_k    | `Windows`   | samples i with t_k + a - tau_i <= t_i <= t_k + b + tau_i                    | (T,)  |      |

A border that is open excludes the samples of its instant: a sample i of [a, b) has t_i < t_k + b - tau_i. Windows of
the past are those of [t_k - b, t_k - a]. Those of `next` and `previous` are the sample beside k, whatever its time.

Before the start of a trajectory there is nothing: a window of the past that ends there is empty. What is behind the end
is not known: a window ahead that reaches beyond is refused, or with `beyond` = "truncate" has the samples that there
are. Everywhere else an empty window is refused: its interval falls between two samples.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....schemas.instants import reached
from ....schemas.values import Beyond
from .errors import FormulaError
from .horizon import check_horizon
from .text import excerpt
from .tree import (
    REST,
    STEP_BACK,
    Edge,
    Formula,
    Next,
    Since,
    Span,
    Temporal,
    Timed,
    Until,
    operands,
    span,
    walk,
)

__all__ = ["Grid", "OtherReading", "Windows"]

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Windows:
    """One run of samples for each sample k: from `first[k]` up to, but without, `stop[k]`; empty if they are equal.

    What follows from them is derived once, for all rollouts on one grid.
    """

    first: Indices  # (T,)
    stop: Indices  # (T,)

    def are(self, other: "Windows") -> bool:
        """Whether these are the windows of `other`."""
        return np.array_equal(self.first, other.first) and np.array_equal(self.stop, other.stop)

    @cached_property
    def from_now(self) -> "Windows":
        """The windows that begin at their own sample and end where these end."""
        return Windows(np.where(self.empty, self.stop, np.arange(len(self.first))), self.stop)

    @cached_property
    def up_to_first(self) -> "Windows":
        """The windows from their own sample to the first sample of these, included."""
        now = np.arange(len(self.first))
        return Windows(now, np.clip(self.first + 1, now + 1, len(now)))

    @cached_property
    def mirrored(self) -> "Windows":
        """The windows of the trajectory backwards in time."""
        return Windows(len(self.stop) - self.stop[::-1], len(self.first) - self.first[::-1])

    @cached_property
    def empty(self) -> Flags:
        """Which windows have no sample."""
        return self.first >= self.stop

    @cached_property
    def any_empty(self) -> bool:
        """Whether some window has no sample."""
        return bool(self.empty.any())

    @cached_property
    def to_end(self) -> bool:
        """Whether every window ends with the trajectory: then the first one does."""
        return bool(self.stop[0] == len(self.stop))

    @cached_property
    def from_start(self) -> bool:
        """Whether every window begins with the trajectory."""
        return not self.first.any()

    def cover(self, read: Flags) -> Flags:
        """Return for every sample if it belongs to the window of some sample that is `read`."""
        size = len(read) + 1
        # A window adds 1 at its first sample and takes it back at its stop: the running sum counts the windows.
        edges = np.bincount(self.first[read], minlength=size) - np.bincount(self.stop[read], minlength=size)
        return np.cumsum(edges[:-1]) > 0


class Grid:
    """The sample times of a trajectory; they are checked only if a formula has an interval."""

    def __init__(self, times: Floats, beyond: Beyond = "refuse") -> None:
        self._given, self.beyond = times, beyond
        self._windows: dict[Span, Windows] = {}

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

    def windows(self, of: Span) -> Windows:
        """Return the samples that an operator reads at each sample.

        Raises:
            ValueError: the sample times decrease.

        """
        if of not in self._windows:
            self._windows[of] = self._search(of)
        return self._windows[of]

    def _search(self, of: Span) -> Windows:
        size, now = len(self), np.arange(len(self))
        if of.interval is None:
            return Windows(np.maximum(now - 1, 0), now) if of.past else Windows(now + 1, np.minimum(now + 2, size))
        if of.interval == REST:
            return Windows(np.zeros_like(now), now + 1) if of.past else Windows(now, np.full(size, size))
        return self._between(of)

    def _between(self, of: Span) -> Windows:
        assert of.interval is not None
        low, high = of.interval.low, of.interval.high
        opens, closes = of.interval.low_open, of.interval.high_open
        if of.past:
            low, high, opens, closes = -high, -low, closes, opens
        begin, end = self._times + low, self._times + high
        earliest, latest = self._instants(opened=opens)
        first = earliest.searchsorted(begin, "right") if opens else latest.searchsorted(begin, "left")
        earliest, latest = self._instants(opened=closes)
        stop = latest.searchsorted(end, "left") if closes else earliest.searchsorted(end, "right")
        return Windows(first, np.maximum(first, stop))

    def _instants(self, *, opened: bool) -> tuple[Floats, Floats]:
        """Return what counts as the instant of each sample at a border that is open, or not."""
        del opened  # of another reading it decides
        return self._reached

    def outside(self, of: Span) -> Flags:
        """Return which windows may be empty: those before the start, and beyond the end if they are cut there."""
        return _outside(self.windows(of), of, self.beyond)

    def reaches(self, of: Span) -> Flags:
        """Return at which samples a window ends before the trajectory does, shape (T,); one to its end does."""
        if of.past or of.interval is None or not of.interval.bounded or self.beyond == "truncate":
            return np.ones(len(self), dtype=np.bool_)
        found: Flags = self._times + of.interval.high <= self._reached[1][-1]
        return found

    def check(self, tree: Formula) -> None:
        """Raise if a formula cannot be read at the first sample.

        Raises:
            FormulaError: it reaches beyond the last sample, or an interval contains no sample where it is read.
            ValueError: it has intervals, and the sample times decrease.

        """
        over_time = [node for node in walk(tree) if isinstance(node, Temporal)]
        timed = any(isinstance(node, Timed) and node.interval != REST for node in over_time)
        # A formula without intervals compares no times, so that any grid will do.
        if timed and self.beyond == "refuse":
            end = self._times[-1]
            check_horizon(tree, float(end - self._times[0]), slack=float(self._reached[1][-1] - end))
        if timed or any(isinstance(node, Next) for node in over_time):
            self._check(tree, np.arange(len(self)) == 0, later=False)

    def _check(self, tree: Formula, read: Flags, *, later: bool) -> None:
        """Check `tree` where it is `read`; `later`, where `next` may have moved that by a step."""
        if isinstance(tree, Temporal):
            of = span(tree)
            self._check_windows(tree, read & self.windows(of).empty & ~self.outside(of))
            if later and (beyond := np.flatnonzero(read & ~self.reaches(of))).size:
                raise FormulaError(
                    f"`{excerpt(tree)}` is read at t = {self._given[beyond[0]]:.9g} s, a step later than its operator, "
                    f"and reaches beyond the trajectory, which ends at {self._given[-1]:.9g} s: shorten the interval"
                )
            later = later or isinstance(tree, Next)
        for operand, there in zip(operands(tree), self._read(tree, read), strict=True):
            self._check(operand, there, later=later)

    def _check_windows(self, tree: Temporal, refused: Flags) -> None:
        if not refused.any():
            return
        t = self._given[int(np.argmax(refused))]
        if isinstance(tree, Next):
            raise FormulaError(
                f"`{excerpt(tree)}` is read at the last sample, at t = {t:.9g} s, behind which there is none: give the "
                "operator around it an interval that ends a step earlier"
            )
        raise FormulaError(
            f"the interval of `{excerpt(tree)}` contains no sample at t = {t:.9g} s: "
            "make it at least as long as the time between two samples"
        )

    def _read(self, tree: Formula, read: Flags) -> tuple[Flags, ...]:
        """Return where each operand of `tree` is read."""
        if not isinstance(tree, Temporal):
            return (read,) * len(operands(tree))
        if isinstance(tree, Edge):
            return (read | self.windows(STEP_BACK).cover(read),)
        return tuple(windows.cover(read) for windows in self.windows_of(tree))

    def windows_of(self, tree: Temporal) -> tuple[Windows, ...]:
        """Return the samples at which each operand of `tree` is read, for each sample."""
        windows = self.windows(span(tree))
        match tree:
            case Until(reading="standard"):
                return windows.from_now, windows
            case Until():
                return windows, windows
            case Since():
                return windows.mirrored.from_now.mirrored, windows
            case _:
                return (windows,)


class OtherReading(Grid):
    """The sample times of a grid with the widest windows within the tolerance around a stamp, or with the narrowest.

    A border that belongs to a window takes in the stamps within its tolerance, if wide, or its number alone. One that
    is open does the opposite. Where a narrow window would have no sample inside of the trajectory it is that of the
    grid: there is no other reading.
    """

    def __init__(self, grid: Grid, *, wide: bool) -> None:
        super().__init__(grid._given, grid.beyond)
        self._grid, self._wide = grid, wide

    def _search(self, of: Span) -> Windows:
        nominal = self._grid.windows(of)
        if of.interval in {None, REST}:
            return nominal
        found = self._between(of)
        if found.are(nominal):
            return nominal
        missing = found.empty & ~_outside(found, of, self.beyond)
        return Windows(np.where(missing, nominal.first, found.first), np.where(missing, nominal.stop, found.stop))

    def _instants(self, *, opened: bool) -> tuple[Floats, Floats]:
        return self._strictly if opened == self._wide else self._grid._reached

    @cached_property
    def _strictly(self) -> tuple[Floats, Floats]:
        return reached(self._times, strict=True)


def _outside(windows: Windows, of: Span, beyond: Beyond) -> Flags:
    """Return which windows are before the start, or where they are cut beyond the end."""
    end = len(windows.first) if beyond == "truncate" else -1
    found: Flags = windows.stop == 0 if of.past else windows.first == end
    return found
