"""A length scale per parameter: the kernel of the scaled parameters, and everything that follows from it.

Every statement is compared with the same one over parameters that were divided by their length scales beforehand.
"""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from perfbound.orchestrator.mathematics.bounds.checks.audit import rise_between_nodes
from perfbound.orchestrator.mathematics.bounds.composition import pointwise_mean
from perfbound.orchestrator.mathematics.bounds.paper.formulas import PaperParameters
from perfbound.orchestrator.mathematics.bounds.paper.method import PaperMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.box_maximum import certified_maximum
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.gp.distinct import OffNodeKernel
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.orchestrator.mathematics.gp.radial import Radial
from perfbound.schemas.values import Observation

LENGTHS = (0.3, 40.0)
"""Of an angle in rad and a speed in km/h, say."""
LOW, HIGH, RESOLUTION = (-0.5, 0.0), (0.5, 120.0), 7
BOX = Lattice(LOW, HIGH, RESOLUTION)
SCALED = Lattice(
    tuple(a / length for a, length in zip(LOW, LENGTHS, strict=True)),
    tuple(b / length for b, length in zip(HIGH, LENGTHS, strict=True)),
    RESOLUTION,
)
FINE = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 61), np.linspace(0, 120, 61)), axis=-1).reshape(-1, 2)
NU = (0.5, 1.5, 2.5, 3.3, 10.0)


def objective(z: Floats) -> Floats:
    """Return a function that changes over the length scales."""
    return np.asarray(0.1 * np.sin(z[..., 0] / 0.3) * np.cos(z[..., 1] / 40.0), dtype=np.float64)


def rigorous(candidates: Lattice | Points, kernel: Matern, **changes: Any) -> RigorousMethod:
    premises = Premises(rkhs_norm=0.6, noise_scale=0.02, delta=0.05, regularisers=((1.0, 1.0),))
    return RigorousMethod(candidates, kernel, premises, alpha=0.01, **changes)


def paper(lattice: Lattice, kernel: Matern, *, refine: bool) -> PaperMethod:
    parameters = PaperParameters(rkhs_norm=0.3, noise_scale=0.01, delta=0.05, alpha=1e-3, c=0.05)
    return PaperMethod(lattice, kernel, parameters, refine=refine)


def nodes_and_bounds(method: RigorousMethod | PaperMethod, points: Floats, tests: int) -> list[tuple[int, float]]:
    """Run a campaign of the function's values at `points`, which are numbered as the candidates."""
    found, proposal = [], method.propose(3)
    for _ in range(tests):
        value = float(objective(points[proposal.node]))
        bound = method.observe(proposal, Observation(value, (value,)))
        found.append((proposal.node, bound.upper if bound.upper is not None else math.nan))
        proposal = method.propose()
    return found


@pytest.mark.parametrize("nu", NU)
@pytest.mark.parametrize("finite", [False, True])
def test_method_rigorous_is_the_one_of_scaled_parameters(nu: float, *, finite: bool) -> None:
    ours: Lattice | Points = BOX
    theirs: Lattice | Points = SCALED
    if finite:
        ours, theirs = (Points(tuple(map(tuple, each.nodes.tolist()))) for each in (BOX, SCALED))
    a = nodes_and_bounds(rigorous(ours, Matern(nu, LENGTHS)), BOX.nodes, 12)
    b = nodes_and_bounds(rigorous(theirs, Matern(nu, 1.0)), BOX.nodes, 12)
    assert [node for node, _ in a] == [node for node, _ in b]
    np.testing.assert_allclose([bound for _, bound in a], [bound for _, bound in b], atol=1e-9)


@pytest.mark.parametrize("nu", [1.5, 10.0])
def test_method_paper_is_the_one_of_scaled_parameters(nu: float) -> None:
    a = nodes_and_bounds(paper(BOX, Matern(nu, LENGTHS), refine=False), BOX.nodes, 20)
    b = nodes_and_bounds(paper(SCALED, Matern(nu, 1.0), refine=False), BOX.nodes, 20)
    assert [node for node, _ in a] == [node for node, _ in b]
    np.testing.assert_allclose([bound for _, bound in a], [bound for _, bound in b], atol=1e-9)


def test_a_refined_proposal_is_better_than_its_node() -> None:
    method = paper(BOX, Matern(2.5, LENGTHS), refine=True)
    proposal = method.propose(3)
    for _ in range(8):
        value = float(objective(np.array(proposal.x)))
        method.observe(proposal, Observation(value, (value,)))
        proposal = method.propose()
    node = BOX.nodes[proposal.node]
    assert proposal.x != tuple(node), "it left the node, by a step that fits each axis"
    assert np.all(np.abs(np.array(proposal.x) - node) <= np.array(BOX.spacing) + 1e-9)


@pytest.mark.parametrize("nu", [1.5, 2.5, 10.0])
def test_the_gradient_off_the_nodes(nu: float) -> None:
    kernel = OffNodeKernel(BOX.nodes, Radial(Matern(nu, LENGTHS)))
    z = np.array([0.13, 47.0])
    value, slope = kernel.gradient(BOX.nodes[:5], z)
    np.testing.assert_allclose(value, kernel.between(BOX.nodes[:5], z), atol=1e-9)
    for number in range(5):
        place = BOX.nodes[number : number + 1]
        numeric = approx_fprime(z, lambda at, place=place: float(kernel.between(place, at)[0]), np.array([1e-7, 1e-5]))
        np.testing.assert_allclose(slope[number], numeric, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("nu", NU)
def test_equal_lengths_are_one_length(nu: float) -> None:
    box = Lattice((0.0, 0.0), (5.0, 4.0), 6)
    a = nodes_and_bounds(rigorous(box, Matern(nu, (2.0, 2.0))), box.nodes / 10, 8)
    b = nodes_and_bounds(rigorous(box, Matern(nu, 2.0)), box.nodes / 10, 8)
    assert [node for node, _ in a] == [node for node, _ in b]
    np.testing.assert_allclose([bound for _, bound in a], [bound for _, bound in b], atol=1e-9)


@pytest.mark.parametrize("nu", NU)
def test_the_cover_of_the_box_is_above_its_band(nu: float) -> None:
    method = rigorous(BOX, Matern(nu, LENGTHS))
    nodes_and_bounds(method, BOX.nodes, 10)
    nodes = float(method.envelope.at(BOX.nodes)[0].max())
    cover = certified_maximum((method.envelope,), BOX, nodes=nodes, slack=0.01)
    # A smooth kernel's cover bounds every function of the set, not the band between the nodes.
    fine = objective(FINE).max() if nu > 2 else float(method.envelope.at(FINE)[0].max())
    assert fine <= cover.upper <= cover.found + 0.01


@pytest.mark.parametrize(("one", "two"), [(LENGTHS, 50.0), ((0.3, 90.0), (0.9, 40.0)), (1.0, LENGTHS)])
def test_a_pair_with_different_lengths_is_combined_start_by_start(
    one: float | tuple[float, float], two: float | tuple[float, float]
) -> None:
    first, second = rigorous(BOX, Matern(0.5, one)), rigorous(BOX, Matern(1.5, two))
    for method in (first, second):
        nodes_and_bounds(method, BOX.nodes, 8)
    mean = pointwise_mean(first.envelope, second.envelope, BOX, clip=(-5.0, 5.0), slack=0.01, extremes=-5.0)
    brute = -float((first.envelope.at(FINE)[0] + second.envelope.at(FINE)[0]).max())
    assert brute - 0.05 <= mean <= brute


def test_the_rise_between_nodes() -> None:
    ours = rise_between_nodes(BOX, Matern(2.5, LENGTHS), 0.2)
    assert ours == pytest.approx(rise_between_nodes(SCALED, Matern(2.5, 1.0), 0.2))


def test_the_number_of_lengths_is_that_of_the_parameters() -> None:
    with pytest.raises(ValueError, match="3 length scales for 2 parameters"):
        rigorous(BOX, Matern(2.5, (1.0, 1.0, 1.0)))
    for wrong in [(), (1.0, 0.0), (math.nan, 1.0)]:
        with pytest.raises(ValueError, match="length_scale"):
            Matern(2.5, wrong)
