"""The objectives: functions from trajectories to the value y of a test.

| symbol   | name      | meaning                                             | shape  | unit       |
|----------|-----------|-----------------------------------------------------|--------|------------|
| s, z     | `samples` | one trajectory; column 0 is the time                | (T, n) | per column |
| rho      |           | robustness, clipped to `clip` = [-m, M]             | ()     | of the predicate |
| r        | `risk_weight` | weight of the standard deviation                | ()     | -          |
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...schemas.system import AfterEnd
from ...schemas.trajectory.early_end import missing_share
from ...schemas.trajectory.trajectory import Trajectory
from ...schemas.values import Beyond
from ..mathematics.stl.predicates import check_grids
from ..mathematics.stl.robustness import Evaluated, evaluated
from ..mathematics.stl.tree import Formula
from .plan import ProblemPlan

Floats = NDArray[np.float64]

LARGEST = 1e100
"""Of a rollout's value, in either direction: no square, sum or difference of such values overflows in a float."""


def measured(value: float, name: str) -> float:
    """Return what a rollout contributes to an observation, if everything that follows can be computed from it.

    Raises:
        ValueError: it is not finite, or beyond `LARGEST`.

    >>> measured(0.5, "the gap")
    0.5

    """
    if abs(_finite(value, name)) > LARGEST:
        raise ValueError(f"{name} is {value:.3g}, beyond {LARGEST:g}")
    return value


def scored(
    formula: Formula, trajectory: Trajectory, after_end: AfterEnd | None, beyond: Beyond = "refuse"
) -> Evaluated:
    """Return the robustness of a rollout, not clipped, with what the system declares of an early end.

    With `beyond` = "truncate" the windows of the formula end with the rollout.

    Formula: rho, and with `after_end = "fail"` min(rho, -(share of the horizon that is missing)) after an early end:
    it violates the specification, by the more the earlier it comes.

    Raises:
        ValueError: as `robustness`.

    """
    found = evaluated(formula, trajectory.columns, trajectory.samples, beyond)
    share = missing_share(trajectory) if after_end == "fail" else 0.0
    return Evaluated(min(found.robustness, -share), by_tolerance=False) if share else found


def clipped(value: float, clip: tuple[float, float]) -> float:
    """Return a robustness clipped to [low, high]; every claim is about this number.

    Raises:
        ValueError: the clip is empty.

    >>> clipped(2.0, (-1.0, 1.0))
    1.0

    """
    low, high = clip
    if not low < high:
        raise ValueError(f"clip is [{low!r}, {high!r}]; its lower end must be below its upper end")
    return min(max(value, low), high)


def signal_sup(column: int, a: Floats, b: Floats) -> float:
    """Return the gap of two trajectories in one column, in the unit of that column. It is not clipped.
    Implements eq. (sim_gap) of [ARA].

    Formula: ||s - z|| = max over the sample times of |s_column - z_column|; `a` and `b` have shape (T, n).

    Raises:
        ValueError: the time grids (column 0) differ, or the difference is not finite.

    >>> signal_sup(1, np.array([[0.0, 1.0], [0.1, 2.0]]), np.array([[0.0, 1.5], [0.1, 1.75]]))
    0.5

    """
    check_grids(a, b)
    with np.errstate(over="ignore"):  # a result that is not finite raises just below
        return _finite(float(np.max(np.abs(a[:, column] - b[:, column]))), "the gap")


def at_common_times(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return two trajectories (T, n) at the times of the one with fewer samples: the other one is interpolated there.

    Of two simulators with unlike time grids; with equal ones they stay what they are.

    >>> [each.tolist() for each in at_common_times(np.array([[0.0, 0.0], [1.0, 2.0]]),
    ...                                            np.array([[0.0, 1.0], [0.5, 3.0], [1.0, 7.0]]))]
    [[[0.0, 0.0], [1.0, 2.0]], [[0.0, 1.0], [1.0, 7.0]]]
    """
    if len(a) == len(b):
        return a, b
    if len(a) > len(b):
        return at_common_times(b, a)[::-1]
    t = a[:, 0]
    # Where rounding has cut off the last step of one of them, its end is compared with the end of the other.
    return a, np.column_stack([t, *(np.interp(t, b[:, 0], b[:, k]) for k in range(1, b.shape[1]))])


def column_maximum(column: int, samples: Floats) -> float:
    """Return the largest value of one column of `samples` (T, n), in the unit of that column.

    Raises:
        ValueError: the maximum is not finite.

    """
    return _finite(float(np.max(samples[:, column])), f"the maximum of column {column}")


def mean(values: Sequence[float]) -> float:
    """Return the mean over replicates, correctly summed, so that their order does not matter.

    Raises:
        ValueError: no value, or one that is not finite.

    >>> mean([0.25, 0.75])
    0.5

    """
    if not values:
        raise ValueError("a test needs at least one rollout")
    for value in values:
        _finite(value, "a rollout's value")
    # Exact before its one rounding: the order in which replicates arrive changes no digit.
    return math.fsum(values) / len(values)


def risk(values: Sequence[float], risk_weight: float) -> float:
    """Return mean - r * sample standard deviation (n - 1 in the denominator) over replicates.
    Implements eq. (robust_real) of [ARA].

    Formula: y = mean(v) - r sd(v). Not a centred sample of E - r sd: E[sd(v)] < sd, so y errs to the unsafe side.

    Raises:
        ValueError: fewer than two values, a value that is not finite, or r < 0.

    >>> round(risk([0.6, 0.7, 0.8], 0.2), 6)
    0.68

    """
    if len(values) < 2:
        raise ValueError(f"a risk needs at least 2 replicates, not {len(values)}")
    if not risk_weight >= 0:
        raise ValueError(f"risk_weight must not be negative, not {risk_weight!r}")
    centre = mean(values)
    # fsum is exact: the order of the replicates changes no digit.
    return centre - risk_weight * math.sqrt(math.fsum((v - centre) ** 2 for v in values) / (len(values) - 1))


def excess(plan: ProblemPlan, robustness: Mapping[tuple[str, int], float], gaps: Sequence[float]) -> float:
    """Return the largest excess of a pair's robustness difference over L times its gap.

    `robustness` is that of the rollout of each (variant, replicate), `gaps` (replicates,) are those of one test. Above
    0 the gap does not dominate the difference of the robustness, and the composition does not follow.
    """
    differences = []
    for replicate, value in enumerate(gaps):
        nominal, true = (robustness[plan.replicate(variant, replicate)] for variant in ("nominal", "true"))
        # The gap `robustness` is one-sided: only a true system that is worse than the nominal one counts.
        signed = nominal - true if plan.gap.kind == "robustness" else abs(nominal - true)
        differences.append(signed - plan.gap.lipschitz * value)
    return max(differences)


def _finite(value: float, name: str) -> float:
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}, not a finite number")
    return value
