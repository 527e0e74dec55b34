"""The cost of a method: an upper end of what it allocates, and the sizes at which it grows."""

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.cost import MethodSize, calibration_memory
from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.bounds.paper.formulas import PaperParameters
from perfbound.orchestrator.mathematics.bounds.paper.method import PaperMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points, point_at
from perfbound.schemas.values import Observation, Proposal

KERNEL = Matern(2.5, 1.0)


def test_the_lattice_of_six_parameters_that_nothing_may_try() -> None:
    rows = 8 * 385 * 21**6
    assert rows / 1e9 == pytest.approx(264, abs=0.5)
    for method in ("paper", "rigorous"):
        assert MethodSize(method, 6, 21**6, 385).memory > rows


def test_only_distinct_starts_cost() -> None:
    few = MethodSize("rigorous", 2, 441, 441)
    assert replace(few, tests=10**6).memory == few.memory
    assert replace(few, tests=10**6).operations == few.operations
    # Between the nodes there are more points than nodes.
    assert replace(few, tests=10**6, refined=True).memory > 1e12
    assert replace(few, tests=10**6, window=10**4).memory == pytest.approx(few.memory, rel=10)


@pytest.mark.parametrize("method", ["paper", "rigorous", "kriging"])
def test_every_size_makes_a_method_larger(method: Any) -> None:
    size = MethodSize(method, 3, 1000, 200, per_axis=4)
    larger = [replace(size, candidates=1331), replace(size, per_axis=5) if size.method == "kriging" else None]
    larger += (
        [] if method == "kriging" else [replace(size, tests=300), replace(size, window=50), replace(size, listed=True)]
    )
    for each in filter(None, larger):
        assert each.memory > size.memory
        assert each.operations >= size.operations


def test_methods_without_a_kernel_cost_little_in_any_dimension() -> None:
    for parameters in (2, 12, 1000):
        assert MethodSize("sample", parameters, 0, 10**6).memory == 0
        assert MethodSize("scenario", parameters, 64, 10**6).memory < 1e7
        assert MethodSize("scenario", parameters, 64, 10**6).operations == 0


def kept_and_largest(make: Any, tests: int) -> tuple[int, int]:
    """Return the bytes that a method keeps after tests at other starts, and the most that it had."""
    rng = np.random.default_rng(0)
    tracemalloc.start()
    try:
        method = make()
        space = method._lattice if isinstance(method, PaperMethod) else method.candidates
        nodes = rng.permutation(space.size)[:tests].tolist()
        pairs = [
            (Proposal(node, point_at(space, node), 0.0, 1.0, 1.0, 1.0), Observation(float(rng.random()), ()))
            for node in nodes
        ]
        method.recall(pairs[:-1])
        method.observe(*pairs[-1])
        method.propose()
        return tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()


def rigorous(space: Lattice | Points) -> Any:
    return lambda: RigorousMethod(space, KERNEL, Premises(2.0, 0.02, 0.05, mixture(2.0, 0.02)), alpha=1e-3)


def paper(space: Lattice) -> Any:
    parameters = PaperParameters(rkhs_norm=2.0, noise_scale=0.02, delta=0.05, alpha=1e-3, c=0.1)
    return lambda: PaperMethod(space, KERNEL, parameters)


@pytest.mark.parametrize(
    ("size", "make"),
    [
        (MethodSize("paper", 4, 6**4, 128), paper(Lattice((0.0,) * 4, (1.0,) * 4, 6))),
        (MethodSize("rigorous", 4, 6**4, 128), rigorous(Lattice((0.0,) * 4, (1.0,) * 4, 6))),
        (MethodSize("rigorous", 2, 21**2, 150), rigorous(Lattice((0.0,) * 2, (1.0,) * 2, 21))),
        (
            MethodSize("rigorous", 12, 1200, 200, listed=True),
            rigorous(Points(tuple(map(tuple, np.random.default_rng(1).random((1200, 12)).tolist())))),
        ),
    ],
)
def test_it_is_an_upper_end_of_what_is_allocated(size: MethodSize, make: Any) -> None:
    """Twice what one method keeps is within it, and it is no more than a few times that."""
    kept, _ = kept_and_largest(make, size.tests)
    assert 2 * kept < 1.5 * size.memory
    assert size.memory < 8 * kept


def test_the_cells_of_a_design_are_what_kriging_takes() -> None:
    tracemalloc.start()
    try:
        method = KrigingMethod(
            Lattice((0.0,) * 3, (1.0,) * 3, 5),
            KERNEL,
            KrigingPremises(2.0, -0.6, (-1.0, 1.0), 0.05),
            spread=0.1,
            budget=KrigingBudget(60, 2, 2),
        )
        method.observe(method.propose(), Observation(-0.5, (-0.5, -0.5)))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    size = MethodSize("kriging", 3, 125, 60, per_axis=2)
    assert 2 * kept < 1.5 * size.memory < 8 * kept


def test_a_calibration_takes_the_square_of_its_starts() -> None:
    assert calibration_memory(20_000) == 4 * calibration_memory(10_000) > 8e9
