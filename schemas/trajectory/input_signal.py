"""Input signals as systems get them: functions of time through the knots of a start, or a sine.

| symbol | name      | meaning                                                                | shape | unit      |
|--------|-----------|------------------------------------------------------------------------|-------|-----------|
| K      |           | number of knots                                                        | ()    | -         |
| H      | `horizon` | duration of the rollout; with `until` that of the knots                | ()    | s         |
| u_k    | `knots`   | value at knot k                                                        | (K,)  | parameter |
| t_k    | `times`   | H k / (K - 1); of `constant` H k / K, so that the last one holds as long | (K,) | s         |
| r      | `rate`    | largest slope between two knots                                        | ()    | parameter/s |
| s_k    |           | share of knot k in what the rate leaves it                             | (K,)  | -         |
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SimulationError
from ..file.signals import Ends, SignalKind, SignalShape
from ..system import SystemSpec
from .trajectory import Trajectory

Floats = NDArray[np.float64]
EARLY = 1e-9
"""Of the horizon: a sample that rounding puts so little before a knot of `constant` belongs to the knot."""

SINE_DIGITS = 10


class Wave(NamedTuple):
    """The numbers of a sine: amplitude and offset in the unit of the signal, frequency in Hz, phase in rad."""

    amplitude: float
    frequency: float
    phase: float
    offset: float


@dataclass(frozen=True)
class InputSignal:
    """One input over time: call it with a time in s, or with an array of times.

    `pchip` is monotone between two knots (Fritsch-Carlson), `linear` straight, `constant` holds each knot until the
    next one. No value leaves the range of the knots; before 0 and behind the last knot the ends hold. A `sine` has no
    knots.

    >>> InputSignal("linear", (0.0, 1.0, 0.5), 4.0)(1.0)
    0.5
    >>> InputSignal("constant", (0.0, 1.0), 4.0)([0.0, 1.9, 2.0, 4.0]).tolist()
    [0.0, 0.0, 1.0, 1.0]
    >>> InputSignal("linear", (0.0, 1.0), 9.0, at=(0.0, 4.0))([2.0, 4.0, 9.0]).tolist()
    [0.5, 1.0, 1.0]

    """

    kind: SignalKind
    knots: tuple[float, ...]
    horizon: float
    at: tuple[float, ...] = ()
    """The times of the knots in s, where they are not at equal distances over the horizon."""
    wave: Wave | None = None
    """Of a sine."""

    @cached_property
    def times(self) -> tuple[float, ...]:
        """The times of the knots (K,), in s."""
        return self.at or _spread(self.kind, len(self.knots), self.horizon)

    @cached_property
    def ends(self) -> Ends:
        """The least and the greatest value that it may have."""
        if self.wave is not None:
            return self.wave.offset - self.wave.amplitude, self.wave.offset + self.wave.amplitude
        return min(self.knots), max(self.knots)

    @property
    def described(self) -> dict[str, Any]:
        """The signal as JSON for a program."""
        if self.wave is not None:
            return {"signal": self.kind, **self.wave._asdict()}
        return {"signal": self.kind, "knots": list(self.knots), "times": list(self.times)}

    @overload
    def __call__(self, t: float) -> float: ...
    @overload
    def __call__(self, t: ArrayLike) -> Any: ...
    def __call__(self, t: ArrayLike) -> Any:
        """Return the value at `t` in s, any shape, in the unit of the parameter: a float for a number."""
        at = np.clip(np.asarray(t, dtype=np.float64), 0.0, self.horizon)
        # Rounding may leave the range of the knots by its last bit, and a limit of the system with it.
        values = np.clip(self._through(at), *self.ends)
        return float(values) if values.ndim == 0 else values

    def _through(self, at: Floats) -> Floats:
        if self.wave is not None:
            amplitude, frequency, phase, offset = self.wave
            # Its last bits depend on the processor, and the trajectories of two hosts are compared.
            sine = np.round(np.sin(2.0 * math.pi * frequency * at + phase), SINE_DIGITS)
            return np.asarray(offset + amplitude * sine, dtype=np.float64)
        if self.kind == "pchip":
            return np.asarray(self._pchip(np.minimum(at, self.times[-1])), dtype=np.float64)
        if self.kind == "linear":
            return np.asarray(np.interp(at, self.times, self.knots), dtype=np.float64)
        last = np.searchsorted(np.array(self.times) - EARLY * self.horizon, at, side="right") - 1
        # NaN is no time, and no knot holds there; the other kinds return it by themselves.
        return np.where(np.isnan(at), np.nan, np.array(self.knots)[last])

    @cached_property
    def _pchip(self) -> Any:
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415  (half a second that few workers need)

        return PchipInterpolator(self.times, self.knots)


def start_values(spec: SystemSpec, x: Sequence[float], horizon: float) -> dict[str, float | InputSignal]:
    """Return a start as a system takes it: the value of each parameter by name, input signals as functions of time.

    `x` has one number for each parameter of `spec`, of an input signal one for each knot or number of it.

    Raises:
        SimulationError: `x` has more or fewer numbers, or a signal no time.

    """
    if len(x) != len(spec.own_parameters):
        raise SimulationError(f"{spec.name} takes {len(spec.own_parameters)} parameters, not {len(x)}")
    if spec.signals and not horizon > 0:
        raise SimulationError(f"{spec.name} takes inputs over time; give a horizon above 0 s")
    values = dict(zip((each.name for each in spec.own_parameters), map(float, x), strict=True))
    signals = {shape.name: _signal(shape, values, horizon) for shape in spec.signals}
    return {each.name: signals.get(each.name, values.get(each.name, 0.0)) for each in spec.declared.parameters}


def with_signals(trajectory: Trajectory, spec: SystemSpec, start: Mapping[str, float | InputSignal]) -> Trajectory:
    """Return a trajectory with the input signals that `spec` has as columns, in their places behind its own."""
    added = [value for name in spec.recorded if isinstance(value := start[name], InputSignal)]
    if not added:
        return trajectory
    samples = np.column_stack((trajectory.samples, *(signal(trajectory.samples[:, 0]) for signal in added)))
    return replace(trajectory, columns=(*trajectory.columns, *spec.recorded), samples=samples)


def _signal(shape: SignalShape, values: Mapping[str, float], horizon: float) -> InputSignal:
    """Return a signal of the parameters (p,) of a start."""
    if shape.parts:
        return _of_parts(shape, values, horizon)
    knots = shape.profile or tuple(values[name] for name in shape.names)
    times = shape.times or (() if shape.until is None else _spread(shape.kind, len(knots), shape.until))
    if shape.rate is not None and shape.ends is not None:
        knots = _limited(knots, times or _spread(shape.kind, len(knots), horizon), shape.rate, shape.ends)
    return InputSignal(shape.kind, knots, horizon, at=times)


def _of_parts(shape: SignalShape, values: Mapping[str, float], horizon: float) -> InputSignal:
    """Return a sine or a step, whose numbers are parameters or fixed."""
    numbers = {key: values.get(f"{shape.name}_{key}", fixed) for key, fixed in shape.parts.items()}
    found = {key: float(value) for key, value in numbers.items() if not isinstance(value, tuple)}
    if shape.kind == "sine":
        return InputSignal("sine", (), horizon, wave=Wave(**found))
    # A program and an FMU take it as any signal that is constant until the next knot.
    if found["at"] > 0:
        return InputSignal("constant", (found["before"], found["after"]), horizon, at=(0.0, found["at"]))
    return InputSignal("constant", (found["after"],), horizon, at=(0.0,))


def _spread(kind: SignalKind, knots: int, duration: float) -> tuple[float, ...]:
    """Return times at equal distances (K,), in s."""
    # Of `constant` each knot holds for 1/K of the duration, the last one as well.
    parts = knots - (kind != "constant")
    return tuple(duration * k / parts for k in range(knots))


def _limited(shares: Sequence[float], times: Sequence[float], rate: float, ends: Ends) -> tuple[float, ...]:
    """Return the knots (K,) of the first knot and the shares behind it; every share in [0, 1] gives allowed ones.

    Formula: u_k = l_k + s_k (h_k - l_k), with l_k = max(low, u_(k-1) - r (t_k - t_(k-1))), and h_k likewise.

    >>> _limited((0.5, 1.0, 0.0), (0.0, 1.0, 2.0), 0.25, (0.0, 1.0))
    (0.5, 0.75, 0.5)
    """
    knots = [shares[0]]
    for share, before, at in zip(shares[1:], times, times[1:], strict=False):
        reach = rate * (at - before)
        low, high = max(ends[0], knots[-1] - reach), min(ends[1], knots[-1] + reach)
        knots.append(min(max(low + share * (high - low), low), high))
    return tuple(knots)
