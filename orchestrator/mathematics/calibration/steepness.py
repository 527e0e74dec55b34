"""Jumps: the steepest places of the values, halved until the difference fades or stays.

| symbol | name         | meaning                                                           | shape | unit   |
|--------|--------------|-------------------------------------------------------------------|-------|--------|
| a, b   | `SteepPlace`      | two starts and their values                                       | (p,)  | -      |
| D      | `difference` | |y_a - y_b| less what the noise explains, at least 0              | ()    | unit J |
| h      | `distance`   | distance of the starts, parameters as shares of their ranges      | ()    | -      |
| D/h    | `quotient`   | it levels off at a slope, and doubles with every halving of a jump | ()   | unit J |

The steepest of several hundred noisy pairs is steep because its noise is large, and its ends keep that noise through
every halving. So with noise a place that looks like a jump is a suspicion, and rollouts that chose nothing decide.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..gp.kernels import Floats, squared_distances
from .sampled import SampledValues

# Halved: quotients among starts that fill the space would need 16 times as many of them for the same contrast.
PLACES = 4
"""Places that are halved."""
NEIGHBOURS = 8
"""Nearest starts that make a pair with each."""
ERRORS = 4.0
"""Standard errors of a difference that count as noise."""
JUMP = 0.25
"""Share of a difference that is left by a jump; a slope leaves 1/2 at each halving, one at its steepest some more."""
FEWEST_HALVINGS = 4
"""With fewer a slope may leave as much as a jump."""
FRESH = 16
"""Fresh rollouts at each end of a suspected jump."""
FRESH_ERRORS = 3.0
"""Standard errors of a difference of fresh rollouts that count as noise: nothing was selected among them."""


@dataclass(frozen=True, slots=True)
class End:
    """One start of a place: its parameters as shares (p,), and the mean of J there with its variance."""

    shares: tuple[float, ...]
    value: float
    variance: float


@dataclass(frozen=True, slots=True)
class SteepPlace:
    """Two starts between which the values change."""

    a: End
    b: End

    @property
    def distance(self) -> float:
        """Distance of the starts."""
        return float(np.linalg.norm(np.subtract(self.a.shares, self.b.shares)))

    @property
    def difference(self) -> float:
        """Difference of the values beyond the noise."""
        return self.beyond(ERRORS)

    def beyond(self, errors: float) -> float:
        """Return by how much the values differ beyond so many standard errors, at least 0."""
        return max(abs(self.a.value - self.b.value) - errors * math.sqrt(self.a.variance + self.b.variance), 0.0)

    @property
    def quotient(self) -> float:
        """Difference quotient, in the unit of J per range of a parameter."""
        return self.difference / self.distance

    @property
    def middle(self) -> tuple[float, ...]:
        """The start in the middle."""
        return tuple((np.add(self.a.shares, self.b.shares) / 2.0).tolist())

    def half(self, middle: End) -> "SteepPlace":
        """Return the half with the larger difference."""
        first, second = SteepPlace(self.a, middle), SteepPlace(middle, self.b)
        return max(first, second, key=lambda each: abs(each.a.value - each.b.value))


@dataclass(frozen=True, slots=True)
class Descent:
    """One place and the halves of it that followed, each of half the distance."""

    places: tuple[SteepPlace, ...]
    fresh: SteepPlace | None = None
    """The last place by rollouts that had no part in its choice; None without noise, where they would be the same."""

    @property
    def is_suspected(self) -> bool:
        """Whether the difference stays while the distance falls."""
        return self._stays(self.places[-1].difference)

    @property
    def is_jump(self) -> bool:
        """Whether it stays in fresh rollouts as well."""
        return self.is_suspected and (self.fresh is None or self._stays(self.fresh.beyond(FRESH_ERRORS)))

    def _stays(self, last: float) -> bool:
        return len(self.places) > FEWEST_HALVINGS and last > 0 and last >= JUMP * self.places[0].difference


def steepest(data: SampledValues, count: int = PLACES) -> list[SteepPlace]:
    """Return the places with the largest quotients among neighbours, no start twice; fewer where no pair differs."""
    pairs = _neighbours(data.shares)
    places = [_pair_place(data, *pair) for pair in pairs]
    order = sorted(range(len(pairs)), key=lambda k: -places[k].quotient)
    chosen: list[SteepPlace] = []
    taken: set[int] = set()
    for k in order:
        if len(chosen) == count or places[k].difference == 0:
            break
        if not taken & set(pairs[k]):
            chosen.append(places[k])
            taken |= set(pairs[k])
    return chosen


def quotients(data: SampledValues, sizes: Sequence[int]) -> list[float]:
    """Return the largest quotient among neighbours of the first `sizes` starts, in the unit of J per range."""
    found = []
    for size in sizes:
        part = data.first(size)
        found.append(max((_pair_place(part, *pair).quotient for pair in _neighbours(part.shares)), default=0.0))
    return found


def _pair_place(data: SampledValues, first: int, second: int) -> SteepPlace:
    a, b = (End(tuple(data.shares[k].tolist()), float(data.values[k]), data.variance) for k in (first, second))
    return SteepPlace(a, b)


def _neighbours(shares: Floats) -> list[tuple[int, int]]:
    """Return each pair of a start and one of its nearest ones, once."""
    square = squared_distances(shares, shares)
    np.fill_diagonal(square, np.inf)
    nearest = np.argsort(square, axis=1, kind="stable")[:, :NEIGHBOURS]
    pairs = {(min(k, int(j)), max(k, int(j))) for k, row in enumerate(nearest) for j in row}
    # Two equal starts have no quotient.
    return sorted(pair for pair in pairs if 0 < square[pair] < np.inf)
