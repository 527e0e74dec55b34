"""The band of a method over D, reduced for a map: few nodes, two axes, the sign of the objective."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...schemas.problem_models import Linearised, PaperProblem, Problem, RigorousProblem, SampleProblem, ScenarioProblem
from ...schemas.values import Bound
from ..campaign.methods import ProblemMethod
from ..campaign.plan import ProblemPlan
from ..mathematics.gp.lattice import Lattice
from .data import Series, Surface

Floats = NDArray[np.float64]

MOST_NODES = 3000
"""Nodes of one surface, about; a finer lattice is thinned."""


def surface(plan: ProblemPlan, method: ProblemMethod, bound: Bound) -> Surface:
    """Return the band of `method` after at least one observation; `bound` is the one after the last.

    Raises:
        ValueError: the method has no observation, or its kernel matrix is singular.

    """
    problem, space, found = plan.problem, plan.chosen_from, method.band(bound)
    band = _Arrays(*map(np.array, (found.mean, found.lower, found.upper, found.possible)))
    shape = None
    if isinstance(space, Lattice):
        band, shape = _thinned(_projected(band, space))
    minimum = plan.sense == "min"
    mean, lower, upper = (_series(each, minimum=minimum) for each in (band.mean, band.lower, band.upper))
    return Surface(
        shape=shape,
        points=() if isinstance(space, Lattice) else space.points,
        mean=mean,
        lower=upper if minimum else lower,
        upper=lower if minimum else upper,
        worst=tuple(band.possible.ravel().tolist()),
        band=_meaning(problem, method),
    )


def _meaning(problem: Problem, method: ProblemMethod) -> str:
    """Return the meaning of the lower and upper values of a surface, in words."""
    match problem:
        case PaperProblem():
            sigma = "variance" if problem.sigma == "variance" else "standard deviation"
            return (
                f"μ ∓ β σ of Algorithm 1 at the nodes, σ read as the {sigma}; by its lemma J is within "
                f"with probability at least {1 - problem.delta:g}"
            )
        case RigorousProblem():
            return f"at all candidates at once with probability at least {method.probability:g}"
        case SampleProblem():
            return ""  # it has no candidates
        case ScenarioProblem():
            mean = "linearised risk" if isinstance(problem.linearised, Linearised) else "robustness"
            return (
                f"the lower bound of each start by itself with probability at least {1 - problem.delta:g}; the mean is "
                f"that of its {mean}; a start by itself has no upper bound"
            )


class _Arrays(NamedTuple):
    """A band as arrays of equal shape."""

    mean: Floats
    lower: Floats
    upper: Floats
    possible: NDArray[np.bool_]


def _projected(band: _Arrays, lattice: Lattice) -> _Arrays:
    """Return the worst over all axes but the first two, each array of shape (resolution,) or (resolution,) * 2."""
    shape = (lattice.resolution,) * lattice.dimension
    others = tuple(range(2, lattice.dimension))
    # max for all fields, any for the flags: J is maximised, so the projection hides no bad start
    return _Arrays(*(np.max(each.reshape(shape), axis=others) for each in band))


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


def _series(values: Floats, *, minimum: bool) -> Series:
    """Return the values with the sign of the objective; None where the method has none."""
    signed = 0.0 - values if minimum else values
    return tuple(None if math.isnan(value) else value for value in signed.ravel().tolist())
