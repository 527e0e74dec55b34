"""The robustness of a rollout over time, thinned, and the moment that decides it."""

from collections.abc import Collection

import numpy as np

from ....schemas.result.facts import RolloutFact
from ....schemas.system import ENDED, AfterEnd
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Beyond
from ...mathematics.stl.over_time import deciding_predicates, outermost, robustness_signal, worst_moment
from ...mathematics.stl.text import text
from ...mathematics.stl.tree import Always, Comparison, Eventually, Formula
from ...mathematics.stl.tree import columns as read_columns
from ..data.rollouts import DrawnRollout
from .curves import quantity, thinned


def shown_formula(tree: Formula | None) -> tuple[str, str]:
    """Return the formula that is evaluated at each moment, and which of its values is the robustness.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> shown_formula(parse_formula("always (abs(phi) <= 0.95)"))
    ('abs(phi) <= 0.95', 'least')
    """
    match None if tree is None else outermost(tree):
        case None:
            return "", ""
        case Always(operand, _):
            return text(operand), "least"
        case Eventually(operand, _):
            return text(operand), "greatest"
        case other:
            return text(other), "first"


def deciding_quantities(trajectory: Trajectory, tree: Formula | None, beyond: Beyond = "refuse") -> frozenset[str]:
    """Return what decides the robustness of a trajectory: the columns that its predicates read, and their quantities.

    None without a specification, or where it is not derived.
    """
    if tree is None:
        return frozenset()
    return _read(deciding_predicates(tree, trajectory.columns, trajectory.samples, beyond))


def _read(predicates: Collection[Comparison]) -> frozenset[str]:
    return frozenset(map(quantity, predicates)).union(*map(read_columns, predicates))


def with_margin(
    fact: RolloutFact,
    trajectory: Trajectory,
    tree: Formula | None,
    after_end: AfterEnd | None = None,
    beyond: Beyond = "refuse",
) -> DrawnRollout:
    """Return a recorded rollout with its robustness over time, which a rollout without a robustness has not."""
    t, margin, moment, columns = tuple[float, ...](), tuple[float, ...](), None, frozenset[str]()
    samples = trajectory.samples
    if tree is not None and fact.robustness is not None and len(samples) > 1:
        signal = robustness_signal(tree, trajectory.columns, samples, beyond)
        read = ~np.isnan(signal.values)
        t, margin = thinned(samples[read, 0], signal.values[read])
        # Down the tree of the formula, not where the signal is least: right for nested operators and until as well.
        found = worst_moment(tree, trajectory.columns, samples, beyond)
        if found is not None:
            moment = float(samples[found.first, 0]), float(samples[found.last, 0])
            columns = _read(found.predicates)
    failed_at = fact.ended if after_end == "fail" and fact.robustness is not None else None
    if failed_at is not None:
        moment, columns = (failed_at, failed_at), frozenset({ENDED.name})
    return DrawnRollout(
        id=str(fact.rollout),
        variant=fact.rollout.variant,
        replicate=fact.rollout.replicate,
        seed=fact.seed,
        robustness=fact.robustness,
        t=t,
        margin=margin,
        moment=moment,
        columns=tuple(sorted(columns)),
        failed_at=failed_at,
    )
