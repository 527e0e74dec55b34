"""Campaigns of method `rigorous` with `regions = true`: boxes that are certified safe (J < 0) or unsafe (J > t).

The regions are divided several times in a campaign and judged each time: at the corners and centres of the boxes, on a
fine grid, and at the centres of J. A sign that changes between all of these can stay undetected.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Mixture, Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.regions import SAFE, UNDECIDED, UNSAFE, Regions, divide
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.fakes.observations import an_observation
from tests.studies.coverage.functions import SIDE, Floats, Function, fine_points, random_function
from tests.studies.coverage.noises import NOISES
from tests.studies.coverage.rigorous import LENGTHS, NORM, RESOLUTIONS, Counts, places

MAX_CELLS = 1_500
"""Boxes that one division may examine; a campaign may examine 150,000."""
FLAT_NORM, FLAT_LENGTH, FLAT_MIXTURE = 0.1, 1e3, ((1.0, 1.0),)
"""Of J = 0 with a kernel that is nearly constant, so that all tests are of one value, and a single regulariser."""


@dataclass(frozen=True)
class Region:
    """One row: J has norm NORM exactly, or is `flat`: 0 everywhere, so that every certified box is false."""

    kind: ClassVar[str] = "regions"
    dimension: int = 2
    nu: float = 2.5
    noise: str = "Gaussian"
    window: int = 1
    noise_scale: float = 0.2
    unsafe_above: float = 0.0
    flat: bool = False
    tests: int = 32
    delta: float = 0.1

    @property
    def claimed(self) -> float:
        """The failure probability that the method claims, for all boxes together."""
        return self.delta if self.noise_scale > 0 else 0.0


def rows() -> Iterator[Region]:
    """Every noise with a flat J, where least is to spare; dimensions, smoothness, no noise, and t above 0."""
    for noise, window in zip(NOISES, (1, 8, 1, 1), strict=True):
        yield Region(1, 2.5, noise, window, noise_scale=0.1, flat=True, delta=0.5)
    yield Region(1, 2.5, "Gaussian", 1, noise_scale=0.1, flat=True)
    yield Region(1, 0.5, "skewed", 1, noise_scale=0.05)
    yield Region(1, 2.5, "Gaussian", 8, noise_scale=0.1)
    yield Region(2, 1.5, "+-R", 1, noise_scale=0.02)
    yield Region(2, 2.5, "adaptive", 1, noise_scale=0.02)
    yield Region(2, 2.5, "skewed", 8, noise_scale=0.02, unsafe_above=0.1)
    yield Region(3, 2.5, "+-R", 1, noise_scale=0.01)
    yield Region(2, 2.5, "Gaussian", 1, noise_scale=0.0, tests=16)


class Setting:
    """One campaign's truth and premises."""

    def __init__(self, row: Region, rng: np.random.Generator) -> None:
        self.box = Lattice(
            (0.0,) * row.dimension, (SIDE,) * row.dimension, 2 if row.flat else RESOLUTIONS[row.dimension]
        )
        self.kernel = Matern(row.nu, FLAT_LENGTH if row.flat else LENGTHS[row.dimension])
        self.norm = FLAT_NORM if row.flat else NORM
        self.j: Function
        if row.flat:
            self.j, self.points = (lambda z: np.zeros(len(z))), fine_points(rng, row.dimension)
        else:
            length = LENGTHS[row.dimension]
            known = random_function(rng, row.dimension, nu=row.nu, length_scale=length, norm=NORM)
            self.j, self.points = known, fine_points(rng, row.dimension, known)
        self.values: Floats = self.j(self.box.nodes)

    def mixture(self, noise_scale: float) -> Mixture:
        """Return the regularisers: a single one has more power to exclude J than a mixture."""
        if noise_scale == 0.0:
            return ()
        return FLAT_MIXTURE if self.norm == FLAT_NORM else mixture(self.norm, noise_scale)


def campaign(row: Region, rng: np.random.Generator, *, told: float | None = None) -> Counts:
    """Run one campaign, whose method may get another delta, and return what was false whenever D was divided."""
    truth = Setting(row, rng)
    premises = Premises(truth.norm, row.noise_scale, told or row.delta, truth.mixture(row.noise_scale))
    method = RigorousMethod(truth.box, truth.kernel, premises, alpha=0.05 * truth.norm, unsafe_above=row.unsafe_above)
    past: list[float] = []
    safe = unsafe = False
    decided = 0.0
    for n, index in zip(range(1, row.tests + 1), places(method, rng, truth.box.size, row.window), strict=False):
        past.append(NOISES[row.noise](rng, row.noise_scale, index, past) if row.noise_scale else 0.0)
        test = an_observation(index, float(truth.values[index]) + past[-1])
        if not _is_divided(n, row.tests):
            method.recall([test])
            continue
        method.observe(*test)
        if method.bound().status == "refuted":
            break
        boxes = divide(
            method.envelope,
            np.array(truth.box.low),
            np.array(truth.box.high),
            upper=method.bound().upper,
            unsafe_above=row.unsafe_above,
            max_cells=MAX_CELLS,
        )
        found = false_boxes(boxes, truth.j, truth.points, row.unsafe_above)
        safe, unsafe, decided = safe or found[0], unsafe or found[1], 1.0 - boxes.of(UNDECIDED)
    refuted = method.bound().status == "refuted"
    return {
        "failed": safe or unsafe or refuted,
        "safe": safe,
        "unsafe": unsafe,
        "refuted": refuted,
        "decided": decided,
        "tests": len(past),
    }


def false_boxes(boxes: Regions, j: Function, points: Floats, unsafe_above: float) -> tuple[bool, bool]:
    """Return whether J >= 0 somewhere in a safe box, and whether J <= t somewhere in an unsafe one.

    Boxes are proven with a margin of 1e-9 to both, far above the rounding of J here.
    """
    values = j(points)
    return (
        _inside(boxes, SAFE, points[values >= 0.0]) or bool((_at_boxes(boxes, SAFE, j) >= 0.0).any()),
        _inside(boxes, UNSAFE, points[values <= unsafe_above])
        or bool((_at_boxes(boxes, UNSAFE, j) <= unsafe_above).any()),
    )


def _is_divided(n: int, tests: int) -> bool:
    return n == tests or n & (n - 1) == 0


def _inside(boxes: Regions, status: int, points: Floats) -> bool:
    """Return whether a point is in a box of a status, its edges included."""
    mine = boxes.status == status
    low, high = boxes.low[mine], boxes.high[mine]
    return bool(np.all((low <= points[:, None, :]) & (points[:, None, :] <= high), axis=2).any())


def _at_boxes(boxes: Regions, status: int, j: Function) -> Floats:
    """Return J at the corners and at the centre of every box of a status."""
    mine = boxes.status == status
    low, high = boxes.low[mine], boxes.high[mine]
    ends = product((0.0, 1.0), repeat=low.shape[1])
    parts = [*map(np.array, ends), np.full(low.shape[1], 0.5)]
    points = np.concatenate([low * (1.0 - part) + high * part for part in parts])
    return j(points) if len(points) else np.empty(0)
