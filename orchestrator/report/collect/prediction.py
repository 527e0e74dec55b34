"""What the model of a finished campaign predicts at the fresh starts of its spot check, beside what was observed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ....schemas.result.certificate import SpotCheck
from ....schemas.values import Bound
from ...campaign.methods import ProblemMethod
from ...campaign.plan import ProblemPlan
from ...mathematics.bounds.rigorous.method import RigorousMethod
from ...mathematics.gp.lattice import Lattice
from ..data.charts import Prediction, Series
from . import limits
from .fresh_starts import FreshStarts
from .posterior import anywhere

Floats = NDArray[np.float64]

MOST_POINTS = 1000
"""Starts in the data; every one outside, and an even choice of the others."""
SAME = 1e-9
"""Distance from a bound, as a share of its size, that counts as on it: a value may be computed in another order."""


def prediction(
    spot: SpotCheck, tests: FreshStarts, plan: ProblemPlan, method: ProblemMethod, bound: Bound
) -> Prediction | None:
    """Return prediction and observation of one problem; None where the spot check did not test it.

    `method` has all observations of the campaign, and `bound` is the one after the last.
    """
    keys = [each.key for each in spot.problems]
    starts, values = tests.latest()
    box = plan.candidates
    if plan.key not in keys or not values or not isinstance(box, Lattice):
        return None
    place, nodes = keys.index(plan.key), sorted(values)
    x = np.array([starts[node] for node in nodes])
    each = np.array([np.mean(values[node][place :: len(keys)]) for node in nodes])
    if isinstance(method, RigorousMethod):
        mean, lower, upper = anywhere(method, bound, plan, x)
    else:
        mean, lower, upper = _from_candidates(method, bound, box, x)
    mean = limits.within(mean, plan)
    outside = _beyond(each, upper, 1.0) | _beyond(each, lower, -1.0)
    kept = _kept_starts(outside)
    flip = plan.sense == "min"
    ends = (upper, lower) if flip else (lower, upper)
    finding = spot.problems[place]
    return Prediction(
        starts=len(nodes),
        inside=int((~outside).sum()),
        noisy=finding.noisy,
        rollouts=len(values[nodes[0]]) // len(keys),
        limit=finding.limit,
        interpolated=not isinstance(method, RigorousMethod),
        observed=_signed_column(each[kept], flip=flip),
        mean=_signed_column(mean[kept], flip=flip),
        lower=_signed_column(ends[0][kept], flip=flip),
        upper=_signed_column(ends[1][kept], flip=flip),
        outside=tuple(outside[kept].tolist()),
    )


def _from_candidates(method: ProblemMethod, bound: Bound, box: Lattice, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean between the candidates, and the bounds of the nearest one: those in between are no bounds."""
    from scipy.interpolate import interpn  # noqa: PLC0415  (a second of start-up that few commands need)

    band = method.band(bound)
    shape = (box.resolution,) * box.dimension
    axes = [np.linspace(low, high, box.resolution) for low, high in zip(box.low, box.high, strict=True)]
    mean = interpn(axes, np.array(band.mean).reshape(shape), x)
    steps = np.rint((x - np.array(box.low)) / np.array(box.spacing)).astype(np.intp)
    nearest = np.ravel_multi_index(tuple(np.clip(steps, 0, box.resolution - 1).T), shape)
    return mean, np.array(band.lower)[nearest], np.array(band.upper)[nearest]


def _beyond(values: Floats, limit: Floats, sign: float) -> NDArray[np.bool_]:
    """Return which values are above a limit, or below it for sign -1; where there is none, no value is."""
    return np.nan_to_num(sign * (values - limit), nan=-1.0) > SAME * (1.0 + np.nan_to_num(np.abs(limit)))


def _kept_starts(outside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the numbers of the starts in the data."""
    number = len(outside)
    if number <= MOST_POINTS:
        return np.arange(number)
    red, others = np.flatnonzero(outside)[: MOST_POINTS // 2], np.flatnonzero(~outside)
    wanted = min(MOST_POINTS - len(red), len(others))
    even = np.rint(np.linspace(0, max(0, len(others) - 1), wanted)).astype(np.intp)
    return np.sort(np.concatenate([red, others[even]]))


def _signed_column(values: Floats, *, flip: bool) -> Series:
    signed: Sequence[float] = (0.0 - values if flip else values).tolist()
    return tuple(value if np.isfinite(value) else None for value in signed)
