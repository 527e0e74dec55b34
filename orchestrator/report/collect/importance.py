"""The importance of each parameter of a problem, from its posterior mean or from what was observed at drawn starts."""

import math
from collections.abc import Sequence

import numpy as np

from ...campaign.plan import ProblemPlan
from ...mathematics.gp.lattice import Lattice
from ...mathematics.importance import Floats, lattice_effect, lattice_indices, sample_effect, sample_indices
from ..data.charts import Importance, ParameterImportance

FEWEST = 50
"""Tests at drawn starts: of fewer every share may be chance."""
MOST_PARAMETERS = 12
"""Parameters in the data, the most important ones."""
MOST_POINTS = 41
"""Points of a main effect of the model."""
GROUP = 20
"""Tests of one point of an observed main effect, at least, but for few tests."""
GROUPS = 20


def of_model(plan: ProblemPlan, mean: Floats) -> Importance | None:
    """Return the importance for the posterior mean (m,) at the candidates, with the sign of the objective.

    None where the candidates are no lattice over a box, for one parameter, and for a mean that is constant or missing.
    """
    box = plan.candidates
    if not isinstance(box, Lattice) or box.dimension < 2 or not np.isfinite(mean).all():
        return None
    values = mean.reshape((box.resolution,) * box.dimension)
    indices = lattice_indices(values)
    if indices is None:
        return None
    kept = np.unique(np.rint(np.linspace(0, box.resolution - 1, min(MOST_POINTS, box.resolution))).astype(np.intp))
    parameters = []
    for axis in _most_important(indices.total):
        at = np.linspace(box.low[axis], box.high[axis], box.resolution)[kept]
        effect = lattice_effect(values, axis)[kept]
        first, total = float(indices.first[axis]), float(indices.total[axis])
        parameters.append(ParameterImportance(axis, first, total, tuple(at.tolist()), tuple(effect.tolist())))
    return Importance(True, box.size, None, tuple(parameters))


def of_drawn_tests(x: Floats, y: Floats, read: Sequence[int] | None = None) -> Importance | None:
    """Return the importance for values `y` (n,) that were observed at starts `x` (n, p), drawn independently.

    Of the parameters `read`, by default all: among a thousand knots chance makes some of them important. None for
    fewer than `FEWEST` tests, for one parameter, and for values that are all equal.
    """
    axes = list(range(x.shape[1]) if read is None else read)
    if len(x) < FEWEST or len(axes) < 2:
        return None
    shares = sample_indices(x[:, axes], y)
    if shares is None:
        return None
    groups = max(5, min(GROUPS, len(y) // GROUP))
    parameters = []
    for place in _most_important(shares):
        at, effect = sample_effect(x[:, axes[place]], y, groups)
        parameters.append(
            ParameterImportance(axes[place], float(shares[place]), None, tuple(at.tolist()), tuple(effect.tolist()))
        )
    return Importance(False, len(y), 2.0 / math.sqrt(len(y)), tuple(parameters))


def _most_important(shares: Floats) -> list[int]:
    order: list[int] = np.argsort(-shares, kind="stable").tolist()
    return order[:MOST_PARAMETERS]
