"""Input signals as systems get them: functions of time through the knots of a start.

| symbol | name      | meaning                                                                | shape | unit      |
|--------|-----------|------------------------------------------------------------------------|-------|-----------|
| K      |           | number of knots                                                        | ()    | -         |
| H      | `horizon` | duration of the rollout                                                | ()    | s         |
| u_k    | `knots`   | value at knot k                                                        | (K,)  | parameter |
| t_k    | `times`   | H k / (K - 1); of `constant` H k / K, so that the last one holds as long | (K,) | s         |
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SimulationError
from ..file.signals import SignalKind
from ..system import SystemSpec

Floats = NDArray[np.float64]
EARLY = 1e-9
"""Of the horizon: a sample that rounding puts so little before a knot of `constant` belongs to the knot."""


@dataclass(frozen=True)
class InputSignal:
    """One input over time: call it with a time in s, or with an array of times.

    `pchip` is monotone between two knots (Fritsch-Carlson), `linear` straight, `constant` holds each knot until the
    next one. No value leaves the range of the knots; before 0 and behind the horizon the ends hold.

    >>> InputSignal("linear", (0.0, 1.0, 0.5), 4.0)(1.0)
    0.5
    >>> InputSignal("constant", (0.0, 1.0), 4.0)([0.0, 1.9, 2.0, 4.0]).tolist()
    [0.0, 0.0, 1.0, 1.0]

    """

    kind: SignalKind
    knots: tuple[float, ...]
    horizon: float

    @cached_property
    def times(self) -> tuple[float, ...]:
        """The times of the knots (K,), in s."""
        # Of `constant` each knot holds for 1/K of the horizon, the last one as well.
        parts = len(self.knots) - (self.kind != "constant")
        return tuple(self.horizon * k / parts for k in range(len(self.knots)))

    @property
    def described(self) -> dict[str, Any]:
        """The signal as JSON for a program."""
        return {"signal": self.kind, "knots": list(self.knots), "times": list(self.times)}

    @overload
    def __call__(self, t: float) -> float: ...
    @overload
    def __call__(self, t: ArrayLike) -> Any: ...
    def __call__(self, t: ArrayLike) -> Any:
        """Return the value at `t` in s, any shape, in the unit of the parameter: a float for a number."""
        at = np.clip(np.asarray(t, dtype=np.float64), 0.0, self.horizon)
        # Rounding may leave the range of the knots by its last bit, and a limit of the system with it.
        values = np.clip(self._through(at), min(self.knots), max(self.knots))
        return float(values) if values.ndim == 0 else values

    def _through(self, at: Floats) -> Floats:
        match self.kind:
            case "pchip":
                return np.asarray(self._pchip(at), dtype=np.float64)
            case "linear":
                return np.asarray(np.interp(at, self.times, self.knots), dtype=np.float64)
            case "constant":
                last = np.searchsorted(np.array(self.times) - EARLY * self.horizon, at, side="right") - 1
                # NaN is no time, and no knot holds there; the other kinds return it by themselves.
                return np.where(np.isnan(at), np.nan, np.array(self.knots)[last])

    @cached_property
    def _pchip(self) -> Any:
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415  (half a second that few workers need)

        return PchipInterpolator(self.times, self.knots)


def start_values(spec: SystemSpec, x: Sequence[float], horizon: float) -> dict[str, float | InputSignal]:
    """Return a start as a system takes it: the value of each parameter by name, input signals as functions of time.

    `x` has one number for each parameter of `spec`, of an input signal one for each knot.

    Raises:
        SimulationError: `x` has more or fewer numbers, or a signal no time.

    """
    if len(x) != len(spec.own_parameters):
        raise SimulationError(f"{spec.name} takes {len(spec.own_parameters)} parameters, not {len(x)}")
    if spec.signals and not horizon > 0:
        raise SimulationError(f"{spec.name} takes inputs over time; give a horizon above 0 s")
    values = dict(zip((each.name for each in spec.own_parameters), map(float, x), strict=True))
    signals = {
        shape.name: InputSignal(shape.kind, tuple(values[name] for name in shape.names), horizon)
        for shape in spec.signals
    }
    return {each.name: signals.get(each.name, values.get(each.name, 0.0)) for each in spec.declared.parameters}
