"""The margin of a trajectory to its specification over time, and the moments for a strip of pictures.

| symbol | meaning | shape, unit |
|---|---|---|
| T | samples of the trajectory | |
| margin | robustness of the condition at each moment | (T,), unit of the predicates |
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....schemas.trajectory import Floats, Trajectory
from ...mathematics.stl.over_time import robustness_signal
from ...mathematics.stl.tree import Formula


def margins(tree: Formula | None, trajectory: Trajectory) -> Floats | None:
    """Return the margin at every sample, shape (T,), whose least value is the robustness; None if there is none.

    Only `always f` over the whole trajectory, or a conjunction of such, has one.
    """
    if tree is None:
        return None
    found = robustness_signal(tree, trajectory.columns, trajectory.samples)
    return found.values if found.attained == "least" and not np.isnan(found.values).any() else None


@dataclass(frozen=True, slots=True)
class Moment:
    """One picture: the frame of the film, the time in s, the margin, and whether that is the least of all."""

    frame: int
    t: float
    margin: float | None
    worst: bool = False


def moments(trajectory: Trajectory, margin: Floats | None, number: int) -> tuple[Moment, ...]:
    """Return at most `number` moments in order: first, last, and closer together where the margin changes much.

    The moment nearest to the least margin is moved to it.
    """
    rows = trajectory.frames  # (F,)
    t = trajectory.samples[rows, 0]
    wanted = np.searchsorted(_progress(t, margin, rows), np.linspace(0, 1, number) - 1e-9)
    chosen = sorted(set(np.minimum(wanted, len(rows) - 1).tolist()))
    if margin is None:
        return tuple(Moment(frame, float(t[frame]), None) for frame in chosen)
    least = int(margin.argmin())
    worst = int(np.abs(t - trajectory.samples[least, 0]).argmin())
    chosen[int(np.argmin([abs(frame - worst) for frame in chosen]))] = worst
    # Time and margin of the worst moment are exact; its picture is the nearest frame.
    samples = {frame: least if frame == worst else int(rows[frame]) for frame in chosen}
    return tuple(
        Moment(frame, float(trajectory.samples[row, 0]), float(margin[row]), row == least)
        for frame, row in samples.items()
    )


def _progress(t: Floats, margin: Floats | None, rows: NDArray[np.intp]) -> Floats:
    """Return 0 to 1, half by the elapsed time and half by the total change of the margin, shape (F,)."""
    parts = [t - t[0]]
    if margin is not None:
        parts.append(np.concatenate([[0.0], np.cumsum(np.abs(np.diff(margin[rows])))]))
    shares = [part / part[-1] for part in parts if part[-1] > 0]
    mean: Floats = np.mean(shares, axis=0) if shares else np.zeros(len(t))
    return mean
