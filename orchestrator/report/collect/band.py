"""The band of a method over D, reduced for maps: planes of few nodes, with the sign of the objective."""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....schemas.file.problem_models import (
    KrigingProblem,
    Linearised,
    PaperProblem,
    Problem,
    RigorousProblem,
    SampleProblem,
    ScenarioProblem,
)
from ....schemas.values import Bound
from ...campaign.methods import ProblemMethod
from ...campaign.plan import ProblemPlan
from ...certificate.words.bound_text import outward
from ...mathematics.gp.lattice import Lattice
from ..data.page import Series, Surface
from . import limits

Floats = NDArray[np.float64]

MOST_NODES = 3000
"""Nodes of one plane, about; a finer lattice is thinned. With a lattice's `MAX_NODES` all planes have at most 9000."""


def surfaces(plan: ProblemPlan, method: ProblemMethod, bound: Bound, worst: Sequence[float]) -> tuple[Surface, ...]:
    """Return the band of `method` in every plane of two parameters through the start `worst` (p,), or at listed starts.

    `method` has at least one observation, and `bound` is the one after the last.

    Raises:
        ValueError: the method has no observation, or its kernel matrix is singular.

    """
    space, found = plan.chosen_from, method.band(bound)
    band = _Arrays(*map(np.array, (found.mean, found.lower, found.upper, found.possible)))
    band = band._replace(mean=limits.within(band.mean, plan))  # a model may overshoot the clip, no observation can
    meaning = _meaning(plan.problem, method)
    if plan.parts:
        meaning = f"of the worst requirement at each start; for one requirement {meaning}"
    if not isinstance(space, Lattice):
        listed = _signed(band, minimum=plan.sense == "min")
        return (Surface(tuple(range(len(worst))), (), None, space.points, *listed, band=meaning),)
    node = _node_near(space, worst)
    through = tuple(np.array(space.low) + node * np.array(space.spacing))
    planes: list[tuple[int, ...]] = [*combinations(range(space.dimension), 2)] or [(0,)]
    surfaces = []
    for axes in planes:
        thin, shape = _thinned(_through_node(band, space, axes, node))
        signed = _signed(thin, minimum=plan.sense == "min")
        surfaces.append(Surface(axes, through, shape, (), *signed, band=meaning))
    return tuple(surfaces)


def _meaning(problem: Problem, method: ProblemMethod) -> str:
    """Return the meaning of the lower and upper values of a surface, in words."""
    match problem:
        case PaperProblem():
            sigma = "variance" if problem.sigma == "variance" else "standard deviation"
            return (
                f"μ ∓ β σ of Algorithm 1 at the nodes, σ read as the {sigma}; by its lemma J is within "
                f"{_likely(1.0 - problem.delta)}"
            )
        case RigorousProblem():
            return f"at all candidates at once {_likely(method.probability)}"
        case KrigingProblem():
            return (
                f"of every cell by a bound of all cells at once {_likely(method.probability)}; the "
                "claim needs no such union, so it may be stronger; the mean is that of the interpolated values"
            )
        case SampleProblem():
            return ""  # it has no candidates
        case ScenarioProblem():
            mean = "linearised risk" if isinstance(problem.linearised, Linearised) else "robustness"
            return (
                f"the lower bound of each start by itself {_likely(1.0 - problem.delta)}; the mean is "
                f"that of its {mean}; a start by itself has no upper bound"
            )


def _likely(probability: float) -> str:
    # Certainty is that of a system without noise, and rests on the kernel all the same.
    return f"with probability at least {outward(probability, '>=')}" if probability < 1.0 else "if its assumptions hold"


class _Arrays(NamedTuple):
    """A band as arrays of equal shape."""

    mean: Floats
    lower: Floats
    upper: Floats
    possible: NDArray[np.bool_]


def _node_near(lattice: Lattice, x: Sequence[float]) -> NDArray[np.intp]:
    """Return the index of the nearest node along each axis (p,); a refined start is between nodes."""
    steps = (np.array(x) - np.array(lattice.low)) / np.array(lattice.spacing)
    return np.array(np.clip(np.rint(steps), 0, lattice.resolution - 1), dtype=np.intp)


def _through_node(band: _Arrays, lattice: Lattice, axes: tuple[int, ...], node: NDArray[np.intp]) -> _Arrays:
    """Return the band in the plane of `axes` through a node, each array of shape (resolution,) * len(axes)."""
    shape = (lattice.resolution,) * lattice.dimension
    cut = tuple(slice(None) if axis in axes else node[axis] for axis in range(lattice.dimension))
    mean, lower, upper = (each.reshape(shape)[cut] for each in (band.mean, band.lower, band.upper))
    return _Arrays(mean, lower, upper, band.possible.reshape(shape)[cut])


def _thinned(band: _Arrays) -> tuple[_Arrays, tuple[int, ...]]:
    """Return the band at fewer nodes; a node is possible if one of those that it replaces is."""
    size, axes = band.mean.shape[0], band.mean.ndim
    count = _kept(size, int(MOST_NODES ** (1 / axes) + 1e-9))
    taken = np.rint(np.linspace(0, size - 1, count)).astype(np.intp)
    nearest = np.rint(np.arange(size) * (count - 1) / (size - 1)).astype(np.intp)
    # Every dropped node passes its flag on to the nearest kept one: a map must not rule out what the band does not.
    possible = np.zeros((count,) * axes, dtype=np.bool_)
    where = np.ix_(*(nearest,) * axes)
    np.logical_or.at(possible, where, band.possible)
    take = np.ix_(*(taken,) * axes)
    return _Arrays(band.mean[take], band.lower[take], band.upper[take], possible), possible.shape


def _kept(size: int, most: int) -> int:
    """Return the number of nodes to keep of `size`: all, or at most `most`, evenly spaced if that costs less than half.

    >>> _kept(51, 54), _kept(101, 54), _kept(98, 54)
    (51, 51, 54)
    """
    if size <= most:
        return size
    return next((count for count in range(most, most // 2, -1) if (size - 1) % (count - 1) == 0), most)


def _signed(band: _Arrays, *, minimum: bool) -> tuple[Series, Series, Series, tuple[bool, ...]]:
    """Return mean, lower, upper and flags with the sign of the objective: for a minimum the sides change places."""
    mean, lower, upper = (_series(each, minimum=minimum) for each in (band.mean, band.lower, band.upper))
    sides = (upper, lower) if minimum else (lower, upper)
    return mean, *sides, tuple(band.possible.ravel().tolist())


def _series(values: Floats, *, minimum: bool) -> Series:
    """Return the values with the sign of the objective; None where the method has none."""
    signed = 0.0 - values if minimum else values
    return tuple(None if math.isnan(value) else value for value in signed.ravel().tolist())
