"""A Python function that simulates many rollouts in one call, as arrays over them.

| symbol | meaning |
|---|---|
| R | rollouts of one call |
| T | samples of each |
| n | columns, the first one is the time `t` |
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...schemas.errors import SimulationError
from ...schemas.system import OptionValue, Variant
from ...schemas.trajectory.trajectory import Trajectory
from .base import Floats, Progress, Seeds, checked_disturbances, checked_options, checked_starts
from .function import FunctionSystem, array_words, listed_names, real_values


class VectorisedSystem(FunctionSystem):
    """A decorated function that gets each parameter as an array (R,), and `seeds` (R,) as unsigned integers.

    It returns one array (R, T, n - 1), one array (R, T) for each column, or a dict of such arrays; (R,) is one sample
    of each rollout. With `t` in a dict its grid, of shape (T,) or the same for all as (R, T).
    """

    def rollout(
        self,
        x: Sequence[Any],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
        disturbances: Mapping[str, float] | None = None,
    ) -> Trajectory:
        """Call the function for one rollout; raises as that of every function."""
        found = self.rollouts(
            np.array([x], dtype=np.float64),
            variant=variant,
            seeds=np.array([seed], dtype=np.uint64),
            horizon=horizon,
            options=options,
            progress=progress,
            disturbances={name: np.array([value]) for name, value in (disturbances or {}).items()},
        )
        try:
            return Trajectory(self.spec.own_columns, found[0])
        except ValueError as error:
            raise SimulationError(str(error)) from None

    def rollouts(
        self,
        starts: Floats,
        *,
        variant: Variant,
        seeds: Seeds,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
        disturbances: Mapping[str, Floats] | None = None,
    ) -> Floats:
        """Call the function for all starts (R, p), and return its trajectories as one array (R, T, n).

        Raises:
            SimulationError: an argument is outside the spec, or the function returns something else than its columns.
            Cancelled: raised by `progress`.

        """
        spec = self.spec
        chosen = checked_options(spec, starts[0].tolist(), variant=variant, horizon=horizon, options=options)
        checked_starts(spec, starts)
        # Arrays of its own: a function may change them.
        drawn = {name: values.copy() for name, values in checked_disturbances(spec, disturbances).items()}
        given = {"seeds": seeds, "horizon": horizon, "variant": variant, **drawn}
        returned = self._called([starts[:, k].copy() for k in range(starts.shape[1])], given, chosen, progress)
        return as_batch(returned, spec.own_columns, self.step, len(starts))


def as_batch(returned: object, columns: tuple[str, ...], step: float | None, rollouts: int) -> Floats:
    """Return what a vectorised function returned as one array (R, T, n); `columns` begin with `t`.

    Raises:
        SimulationError: it does not have these columns, their shapes differ, or its time is not known.

    """
    found = _by_name(returned, columns[1:], rollouts)
    time = found.pop("t", None)
    shapes = {name: values.shape for name, values in found.items()}
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{name} has {shape}" for name, shape in shapes.items())
        raise SimulationError(f"the columns differ in shape: {listed}; return (rollouts, samples) of each")
    count = next(iter(shapes.values()))[1]
    if time is None:
        if step is None and count != 1:
            raise SimulationError(
                f"{count} samples without time; return a dict with a column 't', or give `step` to the decorator"
            )
        time = np.arange(count, dtype=np.float64) * float(step or 0.0)
    if time.shape not in {(count,), (rollouts, count)}:
        raise SimulationError(f"t has the shape {time.shape}, the columns have {count} samples of {rollouts} rollouts")
    # Column by column in memory, as it is returned and stored: a copy in another order takes as long as simulating.
    array = np.empty((len(columns), rollouts, count)).transpose(1, 2, 0)
    array[:, :, 0] = time
    for k, name in enumerate(columns[1:], start=1):
        array[:, :, k] = found[name]
    return array


def _by_name(returned: object, names: tuple[str, ...], rollouts: int) -> dict[str, Floats]:
    """Return the columns by their names, shape (R, T) each, and `t` if it was returned."""
    if isinstance(returned, Mapping):
        if set(returned) - {"t"} != set(names) - {"t"}:
            raise SimulationError(
                f"the function returned {listed_names(returned)}, its columns are {listed_names(names)}"
            )
        return {
            name: real_values(value, name) if name == "t" else _of_rollouts(real_values(value, name), name, rollouts)
            for name, value in returned.items()
        }
    if isinstance(returned, tuple | list):
        if len(returned) != len(names):
            raise SimulationError(
                f"the function returned {len(returned)} values, its columns are {listed_names(names)}"
            )
        return {
            name: _of_rollouts(real_values(value, name), name, rollouts)
            for name, value in zip(names, returned, strict=True)
        }
    array = real_values(returned, "the returned value")
    if array.ndim < 3 and len(names) == 1:
        return {names[0]: _of_rollouts(array, "the returned value", rollouts)}
    if array.ndim != 3 or array.shape[::2] != (rollouts, len(names)):
        raise SimulationError(
            f"the function returned {array_words(returned) or array_words(array)}; return ({rollouts}, samples, "
            f"{len(names)}) for the columns {listed_names(names)}"
        )
    return {name: array[:, :, k] for k, name in enumerate(names)}


def _of_rollouts(array: Floats, name: str, rollouts: int) -> Floats:
    if array.ndim == 1:
        array = array[:, np.newaxis]  # one sample of each
    if array.ndim != 2 or len(array) != rollouts or not array.shape[1]:
        raise SimulationError(f"{name} has the shape {array.shape}; return ({rollouts}, samples)")
    return array
