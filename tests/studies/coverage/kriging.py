"""Campaigns of method `kriging`, with the right B and with a B that is too small (the audit).

| symbol | name    | meaning                                                              | shape | unit   |
|--------|---------|----------------------------------------------------------------------|-------|--------|
| mu     | `mu`    | mean of a rollout, MEAN + f, where f has the norm NORM exactly       |       | unit X |
| X      |         | a rollout, in [0, 1]; the method gets -X, which it maximises         | ()    | unit X |
|        | `least` | minimum of mu over the box                                           | ()    | unit X |
|        | `node`  | node whose cell has that minimum; its sum of rollouts decides        | ()    | -      |
"""

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal

import numpy as np

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.schemas.values import Observation
from tests.studies.coverage.bounded import BOUNDED
from tests.studies.coverage.functions import SIDE, Known, fine_points, maximum, random_function
from tests.studies.coverage.oracle import ROUNDING

MEAN, NORM = 0.75, 0.15
NU, LENGTH, FLAT_LENGTH = 2.5, 2.5, 1000.0 * SIDE
RESOLUTION = 9
ENDS = (-1.0, 0.0)
"""Of minus a rollout."""
SPREAD = 0.2
"""Guessed standard deviation of a rollout in the rows with the right B, whatever it is."""
SPREADS = {"uniform": 0.06, "nearly exact": 0.006}
FACTORS = (1.0, 1.2, 1.5, 2.0, 4.0)

Order = Literal["planned", "where lowest"]


@dataclass(frozen=True)
class Kriging:
    """One row with the right premises: each of `tests` has `replicates` rollouts, and mu is random or flat."""

    kind: ClassVar[str] = "kriging"
    noise: str = "two points"
    flat: bool = False
    order: Order = "planned"
    tests: int = 50
    replicates: int = 32
    points: int = 3
    delta: float = 0.1
    small_b: float = 1.0
    spread: float = SPREAD

    @property
    def claimed(self) -> float:
        """The failure probability that the method claims."""
        return self.delta

    @property
    def length(self) -> float:
        """Length scale of the kernel."""
        return FLAT_LENGTH if self.flat else LENGTH


@dataclass(frozen=True)
class KrigingAudit(Kriging):
    """One row whose method gets NORM/`small_b`."""

    kind: ClassVar[str] = "kriging-audit"
    noise: str = "uniform"
    tests: int = 100
    replicates: int = 16
    points: int = 5


def rows() -> Iterator[Kriging]:
    """Every noise; tests where values are lowest; flat functions, whose bound may be stopped after every rollout."""
    for noise in BOUNDED:
        yield Kriging(noise)
    for noise in ("two points", "adaptive", "by start"):
        yield Kriging(noise, order="where lowest", tests=100, replicates=16)
    for noise in ("two points", "skewed", "adaptive"):
        yield Kriging(noise, flat=True, tests=200, replicates=1)
    yield Kriging("two points", flat=True, order="where lowest", tests=200, replicates=1, delta=0.5)


def audits() -> Iterator[KrigingAudit]:
    """The power of the audit with noise and nearly without."""
    for noise, spread in SPREADS.items():
        for small_b in FACTORS:
            yield KrigingAudit(noise, small_b=small_b, spread=spread)


@cache
def lattice() -> Lattice:
    """Return the nodes that the box is covered with."""
    return Lattice((0.0, 0.0), (SIDE, SIDE), RESOLUTION)


@cache
def planned(row: Kriging, told_delta: float) -> KrigingMethod:
    """Return the method of a row before its first test: the plan is the same for all campaigns."""
    return KrigingMethod(
        lattice(),
        Matern(NU, row.length),
        KrigingPremises(NORM / row.small_b, -MEAN, ENDS, told_delta),
        spread=row.spread,
        budget=KrigingBudget(row.tests, row.replicates, row.points),
    )


@dataclass(frozen=True)
class Truth:
    """What is true of one campaign: `nodes` are the values of mu at the nodes, `node` has the minimum in its cell."""

    nodes: list[float]
    least: float
    node: int


def truth(row: Kriging, rng: np.random.Generator) -> Truth:
    """Return a function of norm NORM around MEAN."""
    f = random_function(rng, 2, nu=NU, length_scale=row.length, norm=NORM)
    if row.flat:  # m0 - B everywhere: the assumption proves it, and the rollouts leave least to spare
        f = Known(f.kernel, f.centres[:1], np.array([-NORM]))
    fine = fine_points(rng, 2, f)
    place = fine[int(np.argmin(f(fine)))]
    node = int(np.argmin(np.sum((lattice().nodes - place) ** 2, axis=1)))
    return Truth((MEAN + f(lattice().nodes)).tolist(), MEAN - maximum(lambda z: -f(z), fine), node)


def campaign(row: Kriging, rng: np.random.Generator, *, told_delta: float | None = None) -> dict[str, float]:
    """Run one campaign, whose method may get another delta, and return what was false at any time.

    `sum`: the weighted sum of the means at the node that decides was below what the rollouts prove of it. The bound
    follows from it by B alone, so this is the statement that has least to spare.
    """
    delta = told_delta or row.delta
    method, true = deepcopy(planned(row, delta)), truth(row, rng)
    means = np.array([true.nodes[node] for node in method.design.nodes])
    errors, below, seen = 0.0, False, Seen(method.design.size)
    bounds, cost = method.bets.bounds, -math.log(delta)
    for test in range(row.tests):
        point = seen.lowest() if row.order == "where lowest" else method.design.order[test]
        values = BOUNDED[row.noise](rng, means[point], errors, row.replicates)
        errors += float(values.sum()) - row.replicates * means[point]
        seen.add(point, values.tolist())
        proposal = method.proposal_at(method.design.nodes[point], ())
        bound = method.observe(proposal, Observation(-float(values.mean()), tuple((-values).tolist())))
        if bound.verdict == "refuted":  # it ends the campaign, whose claim is the bound before
            break
        below |= bool(bounds._sum[true.node] - cost > bounds._weights[true.node] @ means + ROUNDING)
    assert bound.upper is not None
    wrong, refuted = -bound.upper > true.least + ROUNDING, bound.verdict == "refuted"
    return {
        "sum": below,
        "bound": wrong,
        "refuted": refuted,
        "unnoticed": wrong and not refuted,
        "width": true.least + bound.upper,
        "rollouts": row.tests * row.replicates,
    }


class Seen:
    """Means of the rollouts at the points of the design."""

    def __init__(self, size: int) -> None:
        self._sums, self._counts = np.zeros(size), np.zeros(size)

    def add(self, point: int, values: list[float]) -> None:
        """Add the rollouts of a test."""
        self._sums[point] += sum(values)
        self._counts[point] += len(values)

    def lowest(self) -> int:
        """Return the first point without a test, or the one whose mean is lowest."""
        new = np.flatnonzero(self._counts == 0)
        return int(new[0]) if len(new) else int(np.argmin(self._sums / self._counts))
