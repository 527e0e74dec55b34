"""Design of method `kriging`: which starts are tested, how often, and in which order; fixed by the budget alone.

| symbol | name     | meaning                                        | shape | unit |
|--------|----------|------------------------------------------------|-------|------|
| p      |          | number of parameters, 1 to 6                   | ()    | -    |
| q      | `size`   | number of points of the design                 | ()    | -    |
| l_j    | `lengths` | length scales of the kernel                   | (p,)  | of x |
| x_i    | `nodes`  | point i, as the index of a node of the lattice | (q,)  | -    |
| n_i    | `counts` | tests at x_i within the budget                 | (q,)  | -    |
|        | `order`  | point of every test, as its number i           | (T,)  | -    |

Of up to three parameters the points are a grid of k^p at most; of more, the corners of the box and points of the Sobol
sequence, scattered between them. Corners and edges get more tests than inner points: a lower bound is extrapolated
there, and the minimum of many systems is there. The order keeps the counts in proportion after every test, corners
first.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heapreplace
from itertools import product

import numpy as np

from ...gp.lattice import Lattice
from ...sobol import sobol_blocks

# Equal shares cost 0.009 of a Segway bound at 1,600 rollouts and nothing at 6,400; steeper ones gained no more than the
# noise of the seeds.
SHARES = (10, 27, 50, 90)
"""Tests of a point in relation to others, by the number of parameters that are at an end of their range."""
PER_PARAMETER = ((400, 5), (150, 4), (0, 3))
"""Points per parameter from so many rollouts on, for one or two parameters: few rollouts are best at few points."""
PER_PARAMETER_OF_THREE = ((10_000, 4), (0, 3))
FEWEST_ALONG = 3
"""Two points along a parameter were worse even where the middle of three had no test."""
GRID_PARAMETERS = 3
"""No grid fills a box of more."""
SCATTERED = {4: 40, 5: 64, 6: 96}
"""Points of a design of more parameters, corners included; half or twice as many changed bounds by less than .02 B."""
OF_A_CORNER = 6
"""Tests at a corner for each one at another scattered point; 3 was worse by .02 B, 1 by .07."""


@dataclass(frozen=True, slots=True)
class Design:
    """The points of a design as nodes of a lattice, and the point of every test."""

    nodes: tuple[int, ...]
    counts: tuple[int, ...]
    order: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of points q."""
        return len(self.nodes)

    def nodes_of(self, first: int, tests: int) -> list[int]:
        """Return the nodes of so many tests from `first` on.

        Raises:
            ValueError: the design has fewer.

        """
        if first + tests > len(self.order):
            raise ValueError(f"the design has {len(self.order)} tests, and all of them are made")
        return [self.nodes[place] for place in self.order[first : first + tests]]


def points_per_parameter(parameters: int, tests: int, replicates: int) -> int:
    """Return the default number of points per parameter for a budget.

    >>> [points_per_parameter(2, tests, 64) for tests in (8, 24, 25)]
    [3, 4, 5]
    """
    table = PER_PARAMETER_OF_THREE if parameters == GRID_PARAMETERS else PER_PARAMETER
    points = next(points for least, points in table if tests * replicates >= least)
    # Points without a test leave gaps.
    while points > FEWEST_ALONG and points**parameters > tests:
        points -= 1
    return points


def most_points(parameters: int, points: int) -> int:
    """Return the most points of a design: `points` for each parameter of a grid, or those that are scattered."""
    return points**parameters if parameters <= GRID_PARAMETERS else SCATTERED[parameters]


def plan_design(lattice: Lattice, tests: int, points: int, lengths: Sequence[float]) -> Design:
    """Return the design of `tests` tests at `points`^p points at most, the nodes nearest to equal distances.

    Of more than three parameters their number is that of `SCATTERED`; `points` and `lengths` have no effect there.

    Raises:
        ValueError: there are more than six parameters, or of a grid fewer than 2 points per parameter, or more than
            nodes.

    >>> design = plan_design(Lattice((0.0, 0.0), (1.0, 1.0), 5), 12, 3, (0.5, 0.5))
    >>> design.nodes
    (0, 2, 4, 10, 12, 14, 20, 22, 24)
    >>> design.order, design.counts
    ((0, 2, 6, 8, 1, 3, 5, 7, 0, 2, 6, 8), (2, 1, 2, 1, 0, 1, 2, 1, 2))

    """
    if lattice.dimension > max(SCATTERED):
        raise ValueError(f"a design is for at most {max(SCATTERED)} parameters, not {lattice.dimension}")
    if lattice.dimension > GRID_PARAMETERS:
        return _design(_scattered(lattice, SCATTERED[lattice.dimension]), tests)
    if not 2 <= points <= lattice.resolution:
        raise ValueError(
            f"points must be between 2 and the {lattice.resolution} nodes per parameter, not {points}; fix points or "
            "resolution"
        )
    ranges = (np.subtract(lattice.high, lattice.low) / lengths).tolist()
    along = points_along(points, ranges, lattice.resolution)
    lasts = [each - 1 for each in along]
    places = list(product(*map(range, along)))
    shares = [SHARES[sum(k in (0, last) for k, last in zip(place, lasts, strict=True))] for place in places]
    return _design({_node(lattice, place, lasts): share for place, share in zip(places, shares, strict=True)}, tests)


def _design(shares: Mapping[int, int], tests: int) -> Design:
    """Return the design of nodes with their shares of the tests."""
    order = _interleaved(list(shares.values()), tests)
    counts = Counter(order)
    return Design(tuple(shares), tuple(counts[i] for i in range(len(shares))), order)


def _scattered(lattice: Lattice, points: int) -> dict[int, int]:
    """Return the corners of a box and the nodes nearest to points of the Sobol sequence, each with its share."""
    last = lattice.resolution - 1
    corners = product((0, last), repeat=lattice.dimension)
    # The coordinates of the sequence are whole multiples of 2^-30: no CPU rounds them differently.
    between = np.floor(next(sobol_blocks(lattice.dimension)) * last + 0.5).astype(int).tolist()
    found = {_index(lattice, place): OF_A_CORNER for place in corners}
    for place in between:
        if len(found) < points:
            found.setdefault(_index(lattice, place), 1)
    return found


def points_along(points: int, ranges: Sequence[float], most: int) -> tuple[int, ...]:
    """Return the points along each parameter, `points`^p in all at most, with distances as equal as that allows.

    `ranges` are in length scales: along a parameter with a short one the objective varies more.

    >>> points_along(5, (2.0, 2.0), 41), points_along(5, (1.8, 0.65), 41), points_along(4, (1.0, 9.0, 1.0), 6)
    ((5, 5), (8, 3), (3, 6, 3))

    """
    found = [min(points, FEWEST_ALONG)] * len(ranges)
    while True:
        for j in sorted(range(len(found)), key=lambda j: (-ranges[j] / (found[j] - 1), j)):
            if found[j] < most and math.prod(found) // found[j] * (found[j] + 1) <= points ** len(found):
                found[j] += 1
                break
        else:
            return tuple(found)


def _node(lattice: Lattice, place: tuple[int, ...], lasts: Sequence[int]) -> int:
    """Return the node nearest to an equally spaced point."""
    # Whole numbers alone: no CPU rounds this differently.
    most = lattice.resolution - 1
    return _index(lattice, [(2 * k * most + last) // (2 * last) for k, last in zip(place, lasts, strict=True)])


def _index(lattice: Lattice, place: Sequence[int]) -> int:
    """Return the index of the node with these places along the parameters."""
    index = 0
    for k in place:
        index = index * lattice.resolution + k
    return index


def _interleaved(shares: list[int], tests: int) -> tuple[int, ...]:
    """Return the numbers of the points so that the counts are in proportion to the shares after every test.

    The next test is at the point with the largest share of the next odd number (Sainte-Lague), the lowest of a tie.
    """
    # share_i/(2 n_i + 1) is compared in whole numbers: no CPU rounds them differently.
    common = math.lcm(*shares)
    waiting = [(common // share, i) for i, share in enumerate(shares)]
    heapify(waiting)
    found = []
    for _ in range(tests):
        quotient, i = waiting[0]
        heapreplace(waiting, (quotient + 2 * common // shares[i], i))
        found.append(i)
    return tuple(found)
