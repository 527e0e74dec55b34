"""Copies among the rollouts of a problem: trajectories that agree bit by bit although their seeds differ."""

from collections.abc import Callable, Iterator, Set

from ...schemas.ids import RolloutId
from ...schemas.trajectory import Trajectory
from .account import Account

MOST = 200
"""Pairs of trajectories that are compared; a simulator that ignores its seeds shows in the first."""


def same_trajectory(a: Trajectory, b: Trajectory) -> bool:
    """Return whether two trajectories agree in every bit of their columns.

    As bytes: -0.0 and 0.0 are equal numbers, and not the same result.
    """
    return a.columns == b.columns and a.samples.shape == b.samples.shape and a.samples.tobytes() == b.samples.tobytes()


def copies(account: Account, noisy: Set[str], load: Callable[[RolloutId], Trajectory]) -> tuple[int, int]:
    """Return how many pairs of rollouts at one start were compared, and how many of them are copies.

    `noisy` are the variants of the problem that depend on the seed, `load` reads the trajectory of an observed rollout.
    """
    compared = found = 0
    for one, other in _candidates(account, noisy):
        if compared == MOST:
            break
        compared += 1
        found += same_trajectory(load(one), load(other))
    return compared, found


def _candidates(account: Account, noisy: Set[str]) -> Iterator[tuple[RolloutId, RolloutId]]:
    """Yield pairs of rollouts at one start with equal values, in the order of the tests."""
    # Copies have equal values, so the files of all other rollouts need not be read.
    plan, variant = account.plan, max(noisy)
    seen: dict[tuple[int, float], RolloutId] = {}
    for test, (node, values) in enumerate(zip(account.nodes, account.each, strict=True)):
        for replicate, value in enumerate(values[: plan.replicates]):
            rollout = RolloutId(plan.name, test, *plan.replicate(variant, replicate))
            earlier = seen.setdefault((node, value), rollout)
            if earlier != rollout:
                yield earlier, rollout
