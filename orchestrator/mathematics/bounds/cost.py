"""What a method costs at most: memory and arithmetic, as functions of its sizes alone.

| symbol | name         | meaning                                                         | unit |
|--------|--------------|-----------------------------------------------------------------|------|
| p      | `parameters` | parameters                                                      | 1    |
| m      | `candidates` | nodes of a lattice, or listed starts                            | 1    |
| T      | `tests`      | tests at most                                                   | 1    |
| n      | `distinct`   | of them, those at other starts                                  | 1    |
| w      | `window`     | tests in flight                                                 | 1    |
| q      | `design`     | most points of the design of method `kriging`                   | 1    |
| s      |              | points of the subgrid of a cell                                 | 1    |
|        | `memory`     | what the method keeps and what it computes with, at its largest | B    |
|        | `operations` | additions and multiplications                                   | 1    |

Whatever refuses a size, or says what it takes, asks here, before anything is allocated. The numbers are upper ends: a
campaign that returns to few starts needs less.
"""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ..blocks import LARGEST
from .kriging.cells import PER_AXIS
from .kriging.design import most_points
from .kriging.weights import STEPS

LARGEST_MEMORY = 8e9
"""Bytes that the methods of one campaign may take."""
LARGEST_PLAN = 1e12
"""Operations of one plan of the weights of method `kriging`: about 25 minutes, in which no result is taken."""
OF_MATRICES, OF_VECTORS = 1e10, 7e8
"""Operations of one core in a second: in products of matrices, and with vectors alone, as method `kriging` has them."""
IN_A_STEP = 20.0
"""Operations for each number of a matrix in a step of the plan of weights, its factor included."""
NUMBER = 8
BLOCKS = 6 * NUMBER * LARGEST
"""Bytes of what is computed block by block, whatever the sizes."""
SCALES = 8 * 20
"""Numbers for each candidate that method `rigorous` computes with: of about 20 regularisers."""
WEALTH = 100_000
"""Bytes of each start in method `scenario`."""
CALIBRATION = 6
"""Matrices of all starts that a calibration has at a time."""


@dataclass(frozen=True, slots=True)
class MethodSize:
    """The sizes of one method, for one objective."""

    method: Literal["paper", "rigorous", "kriging", "scenario", "sample"]
    parameters: int
    candidates: int
    tests: int
    window: int = 1
    listed: bool = False
    """Whether the candidates are listed starts, of which each kernel row is kept once more."""
    refined: bool = False
    """Whether tests are between the nodes, so that there may be more of them than nodes."""
    per_axis: int = 0

    @property
    def distinct(self) -> int:
        """Tests at other starts, at most."""
        return self.tests if self.refined else min(self.tests, self.candidates)

    @property
    def design(self) -> int:
        """Points of a design."""
        return most_points(self.parameters, self.per_axis)

    @property
    def memory(self) -> float:
        """Bytes, without `BLOCKS`, which the methods of a campaign need in turn.

        At the end of a campaign a second method computes the claims again with other constants, so that what a method
        keeps is counted twice: K(X, nodes), K(X, X) and its factor. It is counted once more where it grows.
        """
        n, m, p = float(self.distinct), float(self.candidates), self.parameters
        match self.method:
            case "sample":
                return 0.0
            case "scenario":
                return WEALTH * m
            case "kriging":
                s = float(PER_AXIS[p] ** p)
                return 2 * NUMBER * m * (self.design * (s + 10.0) + 3.0 * p * s)
            case "paper" | "rigorous":
                rows = (5 if self.listed else 3) * n + min(self.window, self.tests)
                each = 2 * p + 8 + (SCALES if self.method == "rigorous" else 0)
                return NUMBER * (m * (rows + each) + 8.0 * n * n)

    @property
    def operations(self) -> float:
        """Operations of all tests; for method `kriging` of one plan of its weights."""
        n, m = float(self.distinct), float(self.candidates)
        match self.method:
            case "sample" | "scenario":
                return 0.0
            case "kriging":
                return IN_A_STEP * STEPS * m * self.design**2
            case "paper" | "rigorous":
                # Summed over the tests: a factor of K(X, X), and its product with K(X, nodes), and for the box between
                # the nodes once more.
                return 4.0 / 3.0 * n**3 * m + 3.0 * n**4

    @property
    def seconds(self) -> float:
        """The time of `operations` on one core, about."""
        return self.operations / (OF_VECTORS if self.method == "kriging" else OF_MATRICES)


def most(largest: int, fits: Callable[[int], bool]) -> int:
    """Return the largest number from 1 to `largest` that fits, where all smaller ones do; 0 if none does.

    >>> most(10, lambda number: number**2 < 50), most(10, lambda number: False)
    (7, 0)
    """
    return bisect_right(range(1, largest + 1), False, key=lambda number: not fits(number))


def calibration_memory(starts: int) -> float:
    """Return the bytes of the kernel matrices of a calibration."""
    return float(CALIBRATION * NUMBER) * starts**2
