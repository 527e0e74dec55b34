"""A log as the trajectory of a rollout: its columns in their units, from the begin of the test to the horizon.

Nothing is repaired: a log whose times do not increase, that has a gap or a number that is none is refused, with the
file and the time.
"""

import struct
from collections.abc import Container, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import EvidenceError, PerfboundError, UnusableTrajectoryError
from ...schemas.file.logs import LogMapping
from ...schemas.instants import ends_early, uncovered
from ...schemas.system import SystemSpec
from ...schemas.trajectory.trajectory import Trajectory
from ..faults import NOT_OF_SYSTEMS, fault_text, missing
from ..handed_in import whole
from .messages import SECOND, Signal, is_of_messages, read_messages
from .tables import MAX_LOG, READERS, TIME, read_table

Floats = NDArray[np.float64]
GAP = 10.0
"""Medians of the steps of a log."""
ULPS = 4
"""Units in the last place of a time, by which a product and a decimal number of the same time may differ."""
SLACK = 1e-9
"""Relative; of times that were computed with a rounding."""
FORMS = ("CSV", "Parquet", "MAT", "MCAP", "bag", "folder of rosbag2")


class LogReader:
    """The reader of the logs of one system.

    `step` is the time between two samples of tables without a time, in s.
    """

    def __init__(self, spec: SystemSpec, mapping: LogMapping | None = None, step: float | None = None) -> None:
        self._spec, self._mapping, self._step = spec, mapping or LogMapping(), step
        own = set(spec.own_columns)
        self._units = {each.name: each.unit for each in spec.columns if each.name in own and each.name != TIME}

    def trajectory(
        self,
        path: Path,
        horizon: float,
        offset: float | None = None,
        constants: Mapping[str, float] | None = None,
    ) -> Trajectory:
        """Return the trajectory in a log; `offset` is the time in it at which the rollout begins, in s.

        `constants` are columns that are one number, and not in the log.

        Raises:
            EvidenceError: it cannot be read, or has not these columns.
            UnusableTrajectoryError: its numbers are not those of a rollout; the text has file and time.

        """
        constants = constants or {}
        log, given = self._checked(path, constants), self._mapping.offset if offset is None else offset
        begin = log.begin if isinstance(given, str) else given - log.base
        signals = {name: self._in_unit(path, name, signal, begin, horizon) for name, signal in log.signals.items()}
        times, columns = self._on_one_grid(path, signals, horizon)
        try:
            found = whole({TIME: times, **columns}, self._spec, constants)
        except UnusableTrajectoryError as error:
            raise UnusableTrajectoryError(f"{path}: {error}") from None
        # One that may end early is held to the horizon.
        if self._spec.after_end is None and (fault := uncovered(found.samples[:, 0], horizon)):
            raise UnusableTrajectoryError(f"{path}: {fault}")
        return found

    def _checked(self, path: Path, constants: Container[str]) -> "_Log":
        try:
            return self._read(path, {name: unit for name, unit in self._units.items() if name not in constants})
        except (PerfboundError, *NOT_OF_SYSTEMS):
            raise
        except BaseException as error:  # noqa: BLE001  (any: a reader at a file of anybody)
            raise EvidenceError(f"{path}: it cannot be read ({_reason(error)})") from None

    def _read(self, path: Path, units: Mapping[str, str]) -> "_Log":
        if "\0" in str(path):
            raise EvidenceError(f"{str(path)!r}: no path of a file")
        if not path.exists():
            raise EvidenceError(f"{path}: No such file or directory")
        if not path.is_dir() and not path.is_file():
            raise EvidenceError(f"{path}: not a file")  # a pipe would be waited for
        if path.is_file() and path.stat().st_size > MAX_LOG:
            raise EvidenceError(f"{path}: more than {MAX_LOG} bytes; cut it")
        if is_of_messages(path):
            stamp, signals = read_messages(path, self._mapping, tuple(units))
            return _Log(stamp / SECOND, signals)
        if path.suffix.lower() not in READERS:
            raise EvidenceError(f"{path}: a log is a {', '.join(FORMS[:-1])} file or a {FORMS[-1]}")
        columns = read_table(path, self._mapping, units)
        lengths = {name: len(each) for name, each in columns.items()}
        if not all(lengths.values()):
            raise EvidenceError(f"{path}: it has no sample; give at least one")
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} has {length}" for name, length in lengths.items())
            raise EvidenceError(f"{path}: {listed} samples; give as many of each")
        count = next(iter(lengths.values()))
        if TIME not in columns:
            if self._step is None and count > 1:
                raise EvidenceError(
                    f"{path}: there is no column {TIME!r}; name that of the time: logs.time under [system], or give "
                    "system.step"
                )
            columns[TIME] = np.arange(count, dtype=np.float64) * (self._step or 0.0)
        times = columns[TIME] * self._mapping.factors.get(TIME, 1.0)
        return _Log(0.0, {name: Signal(times, columns[name]) for name in units})

    def _in_unit(self, path: Path, name: str, signal: Signal, begin: float, horizon: float) -> Signal:
        """Return a signal in its unit with the time of the rollout, as far as the rollout needs it."""
        times, values = signal.times - begin, signal.values * self._mapping.factors.get(name, 1.0)
        # Both numbers were rounded: a stamp that is the offset is at the begin.
        times[np.abs(times) <= ULPS * float(np.spacing(abs(begin)))] = 0.0
        _check_order(path, name, signal.times)
        # One sample before and one behind, for values between them.
        first = max(int(np.searchsorted(times, 0.0, side="right")) - 1, 0)
        last = int(np.searchsorted(times, horizon * (1.0 + SLACK), side="right")) + 1
        if first + 1 >= len(times) and horizon and len(times) > 1:
            raise UnusableTrajectoryError(
                f"{path}: {name} ends at {signal.times[-1]:.10g} s, before the rollout begins, at {begin:.10g} s of "
                f'this log; give offset = "first" under [system.logs]'
            )
        if len(times) > 1 and np.count_nonzero((times >= 0.0) & (times <= horizon * (1.0 + SLACK))) < 2:
            raise UnusableTrajectoryError(f"{path}: {_too_slow(name, times, horizon)}")
        times, values = times[first:last], values[first:last]
        _check_finite(path, name, times + begin, values)
        self._check_gaps(path, name, times, begin)
        if (limits := self._mapping.limits.get(name)) is not None:
            low, high = limits
            if (outside := np.flatnonzero((values < low) | (values > high))).size:
                k = outside[0]
                raise UnusableTrajectoryError(
                    f"{path}: {name} is {values[k]:.6g} at {times[k] + begin:.10g} s, outside the limits "
                    f"[{low:g}, {high:g}] of the mapping; is the unit {self._units[name] or '1'}?"
                )
        return Signal(times, values)

    def _check_gaps(self, path: Path, name: str, times: Floats, begin: float) -> None:
        steps = np.diff(times)
        if not steps.size:
            return
        most = self._mapping.max_gap or GAP * float(np.median(steps))
        if steps.max() > most * (1.0 + SLACK):
            k = int(steps.argmax())
            raise UnusableTrajectoryError(
                f"{path}: {name} has no sample for {steps[k]:.4g} s after {times[k] + begin:.10g} s; allowed are "
                f"{most:.4g} s, or what logs.max_gap under [system] says"
            )

    def _on_one_grid(
        self, path: Path, signals: Mapping[str, Signal], horizon: float
    ) -> tuple[Floats, dict[str, Floats]]:
        """Return the samples of all columns at common times in [0, horizon]."""
        step, first = self._mapping.resample, next(iter(signals.values()))
        if step is not None:
            return _resampled(path, signals, self._grid(signals, step, horizon), self._mapping.between)
        for name, signal in signals.items():
            if not np.array_equal(signal.times, first.times):
                raise UnusableTrajectoryError(
                    f"{path}: {name} has other sample times than {next(iter(signals))}; give the s between two samples "
                    "of the rollout, resample = 0.01, under [system.logs]"
                )
        self._check_end(path, first.times, horizon)
        inside = (first.times >= 0.0) & (first.times <= horizon * (1.0 + SLACK))
        times = first.times[inside]
        if not times.size or times[0] > 0.0:
            start = first.times[0] if not times.size else times[0]
            raise UnusableTrajectoryError(
                f"{path}: its first sample is {start:.6g} s after the begin of the rollout; give offset = "
                '"first", the offset of a sample, or resample, under [system.logs]'
            )
        return times, {name: signal.values[inside] for name, signal in signals.items()}

    def _check_end(self, path: Path, times: Floats, horizon: float) -> None:
        if self._spec.after_end is None and ends_early(times[times <= horizon * (1.0 + SLACK)], horizon):
            raise UnusableTrajectoryError(
                f"{path}: it ends {times[-1]:.6g} s after the begin of the rollout, and the horizon is {horizon:g} s; "
                "give a horizon that every log has, or system.after_end, which says what an early end means"
            )

    def _grid(self, signals: Mapping[str, Signal], step: float, horizon: float) -> Floats:
        """Return the times of the samples; of a system whose rollouts may end early those that all columns reach."""
        last = horizon
        if self._spec.after_end is not None:
            last = min(horizon, *(float(each.times[-1]) for each in signals.values()))
        # As a system that is stepped: a last step that a rounding has cut off is one.
        return np.arange(int(last / step * (1.0 + SLACK)) + 1, dtype=np.float64) * step


class _Log(NamedTuple):
    base: float
    """The time in s from which the times of the signals count."""
    signals: Mapping[str, Signal]

    @property
    def begin(self) -> float:
        """When every column has had a sample."""
        return float(max(each.times[0] for each in self.signals.values()))


def _resampled(
    path: Path, signals: Mapping[str, Signal], times: Floats, between: str
) -> tuple[Floats, dict[str, Floats]]:
    found: dict[str, Floats] = {}
    for name, (own, values) in signals.items():
        if own[0] > times[0] + SLACK or own[-1] < times[-1] * (1.0 - SLACK):
            raise UnusableTrajectoryError(
                f"{path}: {name} has samples from {own[0]:.6g} to {own[-1]:.6g} s of the rollout, not from 0 to "
                f"{times[-1]:.6g} s"
            )
        if between == "linear":
            found[name] = np.interp(times, own, values)
        else:
            # A stamp that a rounding has moved behind its time is at it.
            places = np.searchsorted(own, times + SLACK * np.maximum(1.0, times), side="right") - 1
            found[name] = values[np.maximum(places, 0)]
    return times, found


def _too_slow(name: str, times: Floats, horizon: float) -> str:
    """Return why a log of many samples has one of the rollout, whose time is that of `times`."""
    span = f"{len(times):,} samples of {name} over {times[-1] - times[0]:.6g} s"
    if not horizon:
        return f"it has {span}, and the campaign no horizon; give horizon = {times[-1] - times[0]:.6g}, or less"
    has = f"it has {span}, of which the horizon of {horizon:g} s has at most one"
    if float(np.median(np.diff(times))) < horizon:
        return f'{has}: it begins {times[0]:.6g} s after the rollout; give offset = "first" under [system.logs]'
    return f"{has}: if its time is in another unit, give logs.factors = {{ t = 0.001 }} under [system]"


def _check_order(path: Path, name: str, times: Floats) -> None:
    if not np.isfinite(times).all():
        raise UnusableTrajectoryError(
            f"{path}: a time of {name} is not finite, that of sample {_first(~np.isfinite(times))}"
        )
    back = np.diff(times) <= 0
    if back.any():
        k = int(np.argmax(back))
        before, after = (f"{times[each]:.10g} s" for each in (k, k + 1))
        what = "twice" if before == after else f"after {before}"
        raise UnusableTrajectoryError(f"{path}: {name} has a sample at {after} {what}; times have to increase")


def _check_finite(path: Path, name: str, times: Floats, values: Floats) -> None:
    if (wrong := ~np.isfinite(values)).any():
        k = int(np.argmax(wrong))
        raise UnusableTrajectoryError(f"{path}: {name} is {values[k]} at {times[k]:.10g} s")


def _first(found: NDArray[np.bool_]) -> int:
    return int(np.argmax(found)) + 1


def _reason(error: BaseException) -> str:
    if isinstance(error, ModuleNotFoundError) and error.name:
        return f"{error.name} is not installed; {missing(error.name)}"
    if isinstance(error, EOFError | struct.error) or type(error).__name__ == "EndOfFile":
        return "it is truncated"
    return fault_text(error)
