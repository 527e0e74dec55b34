"""Large computations in blocks: the numbers of one step, and the size of the intermediate arrays."""

from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.blocks import ALIGNED, blocks
from perfbound.orchestrator.mathematics.bounds.rigorous import box_maximum, cells, envelope, regions
from perfbound.orchestrator.mathematics.bounds.rigorous.cells import CHUNK, MOST_CORNERS, chunks
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.calibration.kernel_fit import KernelFit
from perfbound.orchestrator.mathematics.calibration.sampled import SampledValues
from perfbound.orchestrator.mathematics.gp import kernels
from perfbound.orchestrator.mathematics.gp.kernels import Matern, squared_distances
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import Observation

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(("count", "width"), [(1000, 7), (1000, 10**9), (3, 1), (0, 5), (10_000, 100)])
def test_blocks_cover_every_row_once(count: int, width: int) -> None:
    found = list(blocks(count, width, largest=65_536))
    assert [row for part in found for row in range(count)[part]] == list(range(count))
    rows = max(part.stop - part.start for part in found)
    assert rows * width <= 65_536 or rows == 1
    assert all(part.start % ALIGNED == 0 for part in found) or rows <= ALIGNED


@pytest.mark.parametrize("parameters", [1, 3, 8, 40])
def test_squared_distances_are_those_of_one_step_bit_by_bit(monkeypatch: pytest.MonkeyPatch, parameters: int) -> None:
    first, second, axes = RNG.random((50, parameters)), RNG.random((30, parameters)), RNG.random(parameters) + 0.1
    monkeypatch.setattr(kernels, "blocks", partial(blocks, largest=500))
    for scale in (None, axes):
        difference = first[:, None, :] - second[None, :, :]
        steps = difference if scale is None else difference / scale
        assert np.array_equal(squared_distances(first, second, scale), np.sum(steps * steps, axis=2))


def test_no_difference_of_a_thousand_points_is_kept_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    widths = []

    def recorded(count: int, width: int) -> Any:
        widths.append((count, width))
        return blocks(count, width)

    monkeypatch.setattr(kernels, "blocks", recorded)
    points = Points(tuple(map(tuple, RNG.random((300, 100)).tolist())))
    rows = points.kernel_rows(Matern(2.5, 1.0))
    assert widths == [(300, 30_000)]
    assert np.array_equal(rows.row(7)[[3]], rows.row(3)[[7]])


@pytest.mark.parametrize("nu", [1.5, 2.5])
@pytest.mark.parametrize("candidates", [Lattice((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 6), Points(((0.0,), (0.5,), (1.0,)))])
def test_a_bound_in_blocks_is_that_of_one_step(
    monkeypatch: pytest.MonkeyPatch, nu: float, candidates: Lattice | Points
) -> None:
    def bound() -> tuple[float, float, Any]:
        method = RigorousMethod(candidates, Matern(nu, 0.7), Premises(1.0, 0.0, 0.05, ()), alpha=0.01)
        found = None
        for test in range(3 if isinstance(candidates, Points) else 12):
            proposal = method.propose(2 if test == 0 else None)
            found = method.observe(proposal, Observation(0.3 * float(np.sin(4 * sum(proposal.x))), ()))
        assert found is not None
        assert found.upper is not None
        assert found.lower is not None
        return found.upper, found.lower, method.envelope.at(candidates.nodes)

    whole = bound()
    for where in (envelope, cells):
        monkeypatch.setattr(where, "blocks", partial(blocks, largest=700))
    divided = bound()
    assert divided[:2] == pytest.approx(whole[:2], rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(divided[2], whole[2], rtol=1e-12, atol=1e-12)


def test_a_fitted_mean_in_blocks_is_that_of_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    shares = RNG.random((20, 3))
    data = SampledValues(shares, np.sin(shares.sum(axis=1)), 0.0)
    fit, at = KernelFit(2.5, np.array([0.5, 0.6, 0.7]), 1e-8, 1.0, 0.0), RNG.random((200, 3))
    whole = fit.mean(data, at)
    monkeypatch.setattr("perfbound.orchestrator.mathematics.calibration.kernel_fit.blocks", partial(blocks, largest=90))
    np.testing.assert_allclose(fit.mean(data, at), whole, rtol=1e-12)


@pytest.mark.parametrize("parameters", [1, 3, 8, 9, 12, 16, 20])
def test_cells_are_bounded_together_as_their_corners_allow(parameters: int) -> None:
    found = list(chunks(np.zeros((2 * CHUNK + 5, parameters), dtype=np.intp)))
    assert found[0].start == 0
    assert all(before.stop == after.start for before, after in pairwise(found))
    assert found[-1].stop >= 2 * CHUNK + 5
    assert found[0].stop == (CHUNK if parameters <= 8 else max(1, MOST_CORNERS // 2**parameters))


def test_a_box_of_many_parameters_is_not_split_into_corners_without_end() -> None:
    """Of 12 parameters a cell has 4,096 corners, and its 4,096 children would take 2.5 GB."""
    box = Lattice((0.0,) * 12, (1.0,) * 12, 2)
    method = RigorousMethod(box, Matern(2.5, 1.0), Premises(1.0, 0.0, 0.05, ()), alpha=0.01)
    method.observe(method.propose(0), Observation(0.1, ()))
    found = box_maximum.certified_maximum((method.envelope,), box, nodes=0.2, slack=1e-9)
    assert found.cells == 1
    assert found.upper > 0.2
    small = Lattice((0.0,) * 3, (1.0,) * 3, 2)
    method = RigorousMethod(small, Matern(2.5, 1.0), Premises(1.0, 0.0, 0.05, ()), alpha=0.01)
    method.observe(method.propose(0), Observation(0.1, ()))
    assert box_maximum.certified_maximum((method.envelope,), small, nodes=0.2, slack=1e-3).cells > 1000


def test_the_table_of_a_lattice_has_a_number_for_each_node() -> None:
    """With offsets of both signs it had 3^16 numbers in place of 2^16."""
    rows = Lattice((0.0,) * 16, (1.0,) * 16, 2).kernel_rows(Matern(2.5, 1.0))
    assert rows._table.size == 2**16
    assert rows.row(5)[2**16 - 1] == rows.row(2**16 - 1)[5]


def test_regions_examine_as_many_boxes_as_their_corners_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    box = Lattice((0.0, 0.0), (1.0, 1.0), 5)
    method = RigorousMethod(box, Matern(2.5, 1.0), Premises(1.0, 0.0, 0.05, ()), alpha=0.01)
    for node, value in ((0, -0.3), (24, 0.3), (12, 0.0)):
        method.recall([(method.proposal_at(node, ()), Observation(value, ()))])
    low, high = np.array(box.low), np.array(box.high)
    many = len(regions.divide(method.envelope, low, high).low)
    monkeypatch.setattr(regions, "MAX_CORNERS", 4 * 100)
    few = regions.divide(method.envelope, low, high)
    assert len(few.low) <= 100 < many
    assert few.of(regions.UNDECIDED) > 0
