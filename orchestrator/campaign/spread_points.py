"""Fixed starts in a box, spread evenly as the Sobol sequence: what methods choose from where no lattice covers it."""

from functools import lru_cache

import numpy as np

from ...schemas.errors import CampaignError
from ..mathematics.distributions import to_digits
from ..mathematics.gp.points import Points
from ..mathematics.sobol import sobol_blocks
from .draws import DIGITS, LEAST_SHARE
from .region import Start, condition


@lru_cache(maxsize=4)
def spread_points(
    parameters: tuple[str, ...], ends: tuple[tuple[float, float], ...], count: int, where: str | None
) -> Points:
    """Return the first `count` points of the Sobol sequence over a box that are in its region, if it has one.

    `ends` are low and high of each parameter, in their order. Coordinates are rounded to `DIGITS` digits as those of
    drawn starts, so that all machines have the same ones.

    Raises:
        CampaignError: almost nothing of the box is in the region.
        ValueError: `where` is no condition.

    """
    admitted = condition(where, parameters)
    low, high = np.array(ends).T
    found: dict[Start, None] = {}
    most = 2 * count / LEAST_SHARE
    # Unscrambled, and the first ones first: a larger number of candidates repeats a smaller one.
    for number, shares in enumerate(sobol_blocks(len(parameters)), start=1):
        values = low + shares * (high - low)
        # The region first, to round few points of many; and once more, because rounding may leave it.
        if admitted is not None:
            values = values[admitted(values)]
        columns = [to_digits(values[:, k], *each, DIGITS) for k, each in enumerate(ends)]
        starts = list(zip(*columns, strict=True))
        inside = [True] * len(starts) if admitted is None else admitted(starts).tolist()
        found |= {start: None for start, kept in zip(starts, inside, strict=True) if kept}
        if len(found) >= count:
            return Points(tuple(found)[:count])
        if number * len(shares) > most:
            break
    raise CampaignError(
        f"space.where: only {len(found)} of the {count} candidates are in the region; give fewer, or choose narrower "
        "ranges"
    )
