"""Observations without a campaign, as a method takes them."""

from collections.abc import Sequence

from perfbound.schemas.values import Observation, Proposal


def an_observation(
    node: int, value: float | Sequence[float], x: tuple[float, ...] = ()
) -> tuple[Proposal, Observation]:
    """Return a test at candidate `node` with one value of J, or with the robustness of each replicate."""
    each = (value,) if isinstance(value, int | float) else tuple(value)
    return Proposal(node, x, None, None, None, None), Observation(sum(each) / len(each) if each else 0.0, each)
