"""The rollouts at drawn starts as a histogram of their robustness, with the bounds that are numbers of its axis."""

import math
from collections.abc import Sequence

from ...schemas.claims import PROBABILITIES, SAMPLED
from ..campaign.plan import ProblemPlan
from ..mathematics.bounds.sample import SampleMethod
from .data import Drawn, Mark

BINS = 40
"""At most so many bars, about."""

NEAR = 0.5
"""The axis begins at 0 where the least value is at most this share of the spread above it."""


def histogram(plan: ProblemPlan, method: SampleMethod, values: Sequence[float], unit: str) -> Drawn:
    """Return the histogram of `values`, the robustness of the first rollout of each start; there is at least one."""
    low, high = min(values), max(values)
    # The requirement is at 0: worth showing where it is near.
    edges = _edges(min(low, 0.0) if low <= NEAR * (high - low) else low, high)
    counts = [0] * (len(edges) - 1)
    width = edges[1] - edges[0]
    for value in values:
        place = min(max(math.floor((value - edges[0]) / width), 0), len(counts) - 1)
        # Rounding may put a value that is an end on the wrong side of it; 0 separates violations.
        place += (value >= edges[place + 1] and place + 1 < len(counts)) - (value < edges[place] and place > 0)
        counts[place] += 1
    return Drawn(
        edges=tuple(edges),
        counts=tuple(counts),
        violations=sum(value < 0 for value in values),
        unit=unit,
        marks=_marks(plan, method),
    )


def _marks(plan: ProblemPlan, method: SampleMethod) -> tuple[Mark, ...]:
    found = []
    for place, claim in enumerate(plan.claims):
        bound = method.found(place)
        if bound is None or claim.asked.quantity in PROBABILITIES:
            continue
        level = "" if claim.asked.level is None else f" {100 * claim.asked.level:.6g} %"
        factor = "" if claim.asked.factor == 1 else f", factor {claim.asked.factor:g}"
        name = f"{claim.asked.quantity.replace('_', ' ')}{level}{factor}"
        found.append(Mark(name, bound, SAMPLED[claim.asked.quantity].sense))
    return tuple(found)


def _edges(low: float, high: float) -> list[float]:
    """Return the ends of the bars: multiples of 1, 2 or 5 times a power of ten, so that 0 is one of them.

    >>> _edges(-0.3, 1.2)[:3], len(_edges(-0.3, 1.2))
    ([-0.3, -0.25, -0.2], 32)
    """
    least = (high - low) / BINS or abs(low) / BINS or 1.0
    power = 10.0 ** math.floor(math.log10(least))
    width = next(digit * power for digit in (1, 2, 5, 10) if digit * power >= least)
    first, last = math.floor(low / width + 1e-9), math.floor(high / width + 1e-9) + 1
    return [float(f"{k * width:.12g}") for k in range(first, last + 1)]
